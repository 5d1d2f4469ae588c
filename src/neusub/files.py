"""Files are read or it is said why not, and written whole or not at all."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from neusub.errors import MeshFileError

__all__ = ["content_of", "replacing"]


def content_of(path: str | Path) -> bytes:
    """The bytes of a file.  Raises: MeshFileError for a folder, and where it is missing or not readable."""
    path = Path(path)
    try:
        return path.read_bytes()
    except IsADirectoryError:
        raise MeshFileError(f"{path} is a folder. Give a file.") from None
    except FileNotFoundError:
        raise MeshFileError(f"{path} does not exist. Check the name.") from None
    except OSError as error:
        raise MeshFileError(f"{path} cannot be read: {error.strerror}. Check its permissions.") from None


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
