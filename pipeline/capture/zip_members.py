"""Members of a zip archive, known by a few bytes each.

`zipfile` keeps 700 bytes of each member: of a stage of 172 cameras and 30,000 frames 5 GB. Here it reads the list and
is let go.
"""

from __future__ import annotations

import os
import struct
import weakref
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

LOCAL_HEADER = struct.Struct("<4s5H3L2H")
"""Before a member's content: the last two are the lengths of its name and of what is added to it (APPNOTE 4.3.7)."""

PLACES = np.dtype([("offset", "<u8"), ("packed", "<u8"), ("size", "<u8"), ("crc", "<u4"), ("method", "<u2")])
"""What is known of a member beside its name."""


class ZipMembers:
    """An archive whose members can be looked for and read; threads may share it.

    Args:
        archive: the file.

    Raises:
        BadZipFile: if it is none.
    """

    def __init__(self, archive: Path) -> None:
        with zipfile.ZipFile(archive) as opened:
            listed = [each for each in opened.infolist() if not each.is_dir()]
        names = np.array([each.filename.encode() for each in listed], "S") if listed else np.zeros(0, "S1")
        order = np.argsort(names, kind="stable")
        facts = [
            (each.header_offset, each.compress_size, each.file_size, each.CRC, each.compress_type) for each in listed
        ]
        self._archive, self._names, self._places = archive, names[order], np.array(facts, PLACES)[order]
        self._file = os.open(archive, os.O_RDONLY)
        weakref.finalize(self, os.close, self._file)

    def names(self) -> Iterator[str]:
        """Names of the members, in order."""
        return (name.decode() for name in self._names.tolist())

    def __contains__(self, member: str) -> bool:
        """True if there is a member of that name."""
        return self._row(member) is not None

    def read(self, member: str) -> bytes:
        """Content of a member.

        Raises:
            KeyError: if there is none of that name.
            BadZipFile: if it is damaged.
        """
        row = self._row(member)
        if row is None:
            raise KeyError(member)
        offset, packed, size, crc, method = self._places[row].item()
        if method not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            with zipfile.ZipFile(self._archive) as opened:
                return opened.read(member)
        header = os.pread(self._file, LOCAL_HEADER.size, offset)
        if len(header) < LOCAL_HEADER.size or not header.startswith(b"PK\3\4"):
            raise zipfile.BadZipFile(f"no member at byte {offset}")
        content = os.pread(self._file, packed, offset + LOCAL_HEADER.size + sum(LOCAL_HEADER.unpack(header)[-2:]))
        if method == zipfile.ZIP_DEFLATED:
            try:
                content = zlib.decompress(content, -zlib.MAX_WBITS)
            except zlib.error as error:
                raise zipfile.BadZipFile(str(error)) from error
        if len(content) != size or zlib.crc32(content) != crc:
            raise zipfile.BadZipFile(f"the content of {member} is not what the archive's list says")
        return content

    def _row(self, member: str) -> int | None:
        wanted = np.bytes_(member.encode())
        row = int(np.searchsorted(self._names, wanted))
        return row if row < len(self._names) and self._names[row] == wanted else None
