"""Successive self-parameterization: any mesh down, any point back (Liu et al. 2020, section 4.1)."""

from neusub.selfparam.criteria import REASONS, Criteria
from neusub.selfparam.decimation import decimate
from neusub.selfparam.parameterization import SelfParameterization
from neusub.selfparam.placement import PLACE, STRATEGIES

__all__ = ["PLACE", "REASONS", "STRATEGIES", "Criteria", "SelfParameterization", "decimate"]
