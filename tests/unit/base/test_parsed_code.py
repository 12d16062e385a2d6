"""Kept parses of processes that share a folder."""

from __future__ import annotations

import pytest

from pipeline.base.parsed_code import ParsedFiles


def test_two_writers_keep_what_both_parsed(tmp_path, monkeypatch):
    path = tmp_path / "kept.json"
    one, two = ParsedFiles(path), ParsedFiles(path)
    texts = (b"import one\n", b"import two\n")
    for files, text in zip((one, two), texts, strict=True):
        files.read("package", text, "a.py")
        files.save()
    monkeypatch.setattr("pipeline.base.parsed_code.ast.parse", None)
    again = ParsedFiles(path)
    assert [again.read("package", text, "a.py").imports for text in texts] == [{"one"}, {"two"}]


def test_relative_imports_of_equal_texts_follow_their_package():
    files = ParsedFiles()
    text = b"from .part import thing\n"
    assert files.read("one", text, "a.py").imports == {"one.part", "one.part.thing"}
    assert files.read("two.deep", text, "b.py").imports == {"two.deep.part", "two.deep.part.thing"}


def test_old_entries_go_once_there_are_too_many(tmp_path, monkeypatch):
    monkeypatch.setattr("pipeline.base.parsed_code.FULL", 3)
    path = tmp_path / "kept.json"
    sizes = []
    for number in range(6):
        files = ParsedFiles(path)
        files.read("package", f"NUMBER = {number}".encode(), "a.py")
        files.save()
        sizes.append(path.stat().st_size)
    assert sizes[3] == sizes[0] < sizes[1] < sizes[2]


def test_folder_that_takes_no_files_keeps_nothing(tmp_path, monkeypatch):
    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr("pipeline.base.whole_files.os.replace", refuse)
    files = ParsedFiles(tmp_path / "kept.json")
    files.read("package", b"import one", "a.py")
    files.save()
    assert not list(tmp_path.iterdir())


def test_text_that_is_no_python_is_named():
    with pytest.raises(SyntaxError) as refused:
        ParsedFiles().read("package", b"import", "some/file.py")
    assert refused.value.filename == "some/file.py"
