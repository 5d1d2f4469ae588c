"""The report of a map: exact for an identity, known values for known maps."""

from dataclasses import astuple

import numpy as np

import shapes
from neusub.mesh import Mesh
from neusub.selfparam import decimate
from neusub.selfparam.report import quasi_conformal_error


def test_the_report_of_an_identity_is_exact():
    mesh = Mesh(*shapes.bumpy(shapes.icosphere(2)))
    report = decimate(mesh, n_faces=len(mesh.faces)).report()
    error = (report.conformal_median, report.conformal_high, report.conformal_worst)
    assert np.allclose(error, 1, rtol=0, atol=1e-14)  # positions go to the decimator's unit and back: two roundings
    assert (report.flipped, report.degenerate, report.collapses) == (0, 0, 0)
    assert np.allclose(astuple(report.decimated), astuple(report.on_surface), rtol=1e-13)
    assert not any(report.refusals.values())


def test_the_report_counts_and_judges():
    mesh = Mesh(*shapes.bumpy(shapes.icosphere(3)))
    parameterization = decimate(mesh, n_faces=100)
    report = parameterization.report(levels=1)
    assert report.levels == 1
    assert report.collapses == len(mesh.vertices) - len(parameterization.decimated)
    assert "legal" not in report.refusals
    assert 1 < report.conformal_median < report.conformal_high <= report.conformal_worst < np.inf
    assert 0 <= report.flipped < 0.02 and report.degenerate == 0
    assert 0 < report.decimated.quality_low < report.decimated.quality_median < 1
    assert report.decimated != report.on_surface
    assert "flipped triangles" in str(report) and f"{report.collapses:,}" in str(report)


def test_quasi_conformal_error_of_known_maps():
    before = np.array([[0, 0, 0], [1, 0, 0], [0.3, 2, 0], [0.5, 0, 0]])
    faces = np.array([[0, 1, 2], [0, 1, 3]])
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    for scales, expected in (((1, 1, 1), 1), ((7, 7, 7), 1), ((3, 1, 1), 3), ((1, -4, 1), 4)):
        error = quasi_conformal_error(before, before * scales @ turn + 5, faces)
        assert np.isclose(error[0], expected, rtol=1e-12)
        assert error[1] == np.inf  # without area
