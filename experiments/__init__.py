"""Every experiment is a module with a `main`: `python -m experiments list` names them.

They take from neusub what its modules list in `__all__`; names that `neusub` itself has are the ones that stay.
"""
