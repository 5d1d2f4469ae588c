"""Every experiment is a module with a `main`: `python -m experiments list` names them."""
