"""Members of zip archives as `zipfile` wrote them, read by a few bytes each."""

from __future__ import annotations

import sys
import zipfile
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.capture import archives
from pipeline.capture.archives import is_there, members, read_bytes
from pipeline.capture.zip_members import ZipMembers

MEMBERS = {f"cam1/{number:06d}.avif": bytes([number]) * (100 + number) for number in range(50)}


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA])
def test_members_come_back_whatever_packs_them(tmp_path, method):
    with zipfile.ZipFile(tmp_path / "a.zip", "w", method) as archive:
        archive.mkdir("cam1")
        for name, content in reversed(MEMBERS.items()):
            archive.writestr(name, content)
    found = ZipMembers(tmp_path / "a.zip")
    assert list(found.names()) == sorted(MEMBERS)
    with ThreadPoolExecutor(4) as pool:
        assert dict(zip(MEMBERS, pool.map(found.read, MEMBERS), strict=True)) == MEMBERS
    assert "cam1/000007.avif" in found and "cam1/000050.avif" not in found and "" not in found
    with pytest.raises(KeyError):
        found.read("cam1/000050.avif")


def test_archives_of_more_than_four_gigabytes_have_their_places_in_extra_fields(tmp_path, monkeypatch):
    # The limit from which places need 64 bits, lowered: the same fields are written.
    monkeypatch.setattr(zipfile, "ZIP64_LIMIT", 1000)
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for name, content in MEMBERS.items():
            archive.writestr(name, content)
    found = ZipMembers(tmp_path / "a.zip")
    assert all(found.read(name) == content for name, content in MEMBERS.items())


def test_a_damaged_member_and_an_empty_archive_are_told(tmp_path):
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("one.png", b"A" * 100)
    content = path.read_bytes()
    path.write_bytes(content.replace(b"A" * 100, b"A" * 99 + b"B"))
    with pytest.raises(InputError, match=r"one.png is not what the archive's list says"):
        read_bytes(path / "one.png")
    path.write_bytes(b"PK\0\0" + content[4:])
    archives._opened.cache_clear()
    with pytest.raises(InputError, match="no member at byte 0"):
        read_bytes(path / "one.png")
    with zipfile.ZipFile(tmp_path / "empty.zip", "w"):
        pass
    assert members(tmp_path / "empty.zip") == frozenset() and not is_there(tmp_path / "empty.zip/one.png")
    (tmp_path / "no.zip").write_bytes(b"no")
    with pytest.raises(InputError, match="expected a zip archive"):
        is_there(tmp_path / "no.zip/one.png")


def test_a_member_takes_less_than_a_hundred_bytes(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for name in MEMBERS:
            archive.writestr(name, b"")
    found = ZipMembers(tmp_path / "a.zip")
    arrays = [value for value in vars(found).values() if isinstance(value, np.ndarray)]
    assert sum(map(sys.getsizeof, arrays)) / len(MEMBERS) < 100
