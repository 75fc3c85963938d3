"""Folders on a disk or in an object store, and files that are there whole or not at all."""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any, Optional, Union

from .._eisbench import EisError
from .._optional import optional

PathLike = Union[str, "os.PathLike[str]"]


def _files() -> Any:
    return optional("pyarrow.fs", "'eisbench[jobs]'")


class Place:
    """A folder: a path, or an address that pyarrow knows, such as ``s3://bucket/folder``."""

    def __init__(self, address: PathLike, path: Optional[str] = None) -> None:
        files = _files()
        text = os.fspath(address)
        self.address = text if "://" in text else str(Path(text).absolute())
        if "://" in text:
            self.system, self.path = files.FileSystem.from_uri(text)
        else:
            self.system, self.path = files.LocalFileSystem(), self.address
        self.path = path or self.path
        self.is_local = self.system.type_name == "local"

    def __reduce__(self) -> tuple[Any, ...]:
        return (Place, (self.address, self.path))

    def beside(self) -> tuple[Place, str]:
        """The folder that it stands in, and its name there."""
        folder, _, name = self.path.rpartition("/")
        return Place(self.address, folder or "/"), name

    def at(self, name: str) -> str:
        """The path of a file in it."""
        return f"{self.path.rstrip('/')}/{name}" if name else self.path

    def info(self, name: str = "") -> Any:
        """What stands there: ``is_file``, ``size``, …"""
        return self.system.get_file_info(self.at(name))

    def has(self, name: str) -> bool:
        """Whether a file is there."""
        return bool(self.info(name).is_file)

    def names(self, below: str = "", ending: str = "") -> list[str]:
        """The files below it, as paths in it, by name; hidden ones are passed over."""

        selector = _files().FileSelector(self.at(below), recursive=True, allow_not_found=True)
        files = [one.path for one in self.system.get_file_info(selector) if one.is_file]
        root = self.path.rstrip("/") + "/"
        names = [str(path).removeprefix(root) for path in files]
        hidden = [any(part.startswith(".") for part in name.split("/")) for name in names]
        return sorted(n for n, is_hidden in zip(names, hidden) if not is_hidden and n.endswith(ending))

    def open(self, name: str) -> Any:
        """A file for reading at any place."""
        try:
            return self.system.open_input_file(self.at(name))
        except OSError as error:
            raise EisError(f"{self.at(name)}: expected a file: {error}") from None

    def read(self, name: str) -> bytes:
        """The bytes of a file."""
        with self.open(name) as file:
            return bytes(file.read())

    def put(self, name: str, write: Callable[[Any], object]) -> None:
        """Writes a file by ``write``, which is given a stream. The file is there whole or not at
        all: on a disk by a change of its name, in an object store by the end of its upload."""
        if not self.is_local:
            with self.system.open_output_stream(self.at(name)) as stream:
                write(stream)
            return
        into = Path(self.at(name))
        into.parent.mkdir(parents=True, exist_ok=True)
        partial = into.with_name(f".{into.name}.{uuid.uuid4().hex}.partial")
        try:
            with partial.open("wb") as stream:
                write(stream)
                stream.flush()
                os.fsync(stream.fileno())
            partial.replace(into)
        finally:
            partial.unlink(missing_ok=True)
