"""Files are written whole or not at all."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from neusub.errors import MeshFileError

__all__ = ["replacing"]


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A new file beside `path`, which takes its place when the block ends well and vanishes when it does not.

    The new file keeps the suffix, by which writers choose their format.
    Raises: MeshFileError where the folder is missing or not writable, or where `path` is a folder.
    """
    path = Path(path)
    if path.is_dir():
        raise MeshFileError(f"{path} is a folder. Give a file's name.")
    if not path.parent.is_dir():
        raise MeshFileError(f"{path}: the folder {path.parent} does not exist. Make it first.")
    new = path.with_name(f".{path.stem}.part{os.getpid()}-{threading.get_ident()}{path.suffix}")
    try:
        new.touch()  # with the permissions of an ordinary file, whatever the writer would choose
        mode = new.stat().st_mode
        yield new
        new.chmod(mode)
        new.replace(path)
    except PermissionError:
        raise MeshFileError(f"{path}: the folder {path.parent} is not writable. Choose another one.") from None
    finally:
        new.unlink(missing_ok=True)
