import os

import pytest

from nrsfm.errors import FileError
from nrsfm.files.atomic import atomic_file, atomic_folder, check_output_folder


class Stop(BaseException):
    pass


def names(folder):
    return sorted(os.listdir(folder))


def test_file_appears_at_the_end_and_whole(tmp_path):
    path = tmp_path / "a" / "b" / "file.bin"
    with atomic_file(path) as stream:
        stream.write(b"12")
        assert not path.exists()
    assert path.read_bytes() == b"12"
    assert names(path.parent) == ["file.bin"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, Stop])
def test_interrupted_file_leaves_the_old_one_and_nothing_else(tmp_path, error):
    path = tmp_path / "file.bin"
    path.write_bytes(b"old")

    def write(target):
        with atomic_file(target) as stream:
            stream.write(b"new")
            raise error

    with pytest.raises(error):
        write(path)
    assert path.read_bytes() == b"old"
    with pytest.raises(error):
        write(tmp_path / "x" / "y" / "new.bin")
    assert names(tmp_path) == ["file.bin"]


def test_full_disk_is_a_file_error(tmp_path):
    with (
        pytest.raises(FileError, match=r"cannot write '.*f\.bin': No space left"),
        atomic_file(tmp_path / "f.bin"),
    ):
        raise OSError(28, "No space left on device")
    assert names(tmp_path) == []


def test_file_modes_follow_the_umask(tmp_path):
    old = os.umask(0o027)
    try:
        with atomic_file(tmp_path / "f"):
            pass
        with atomic_folder(tmp_path / "d"):
            pass
    finally:
        os.umask(old)
    assert (tmp_path / "f").stat().st_mode & 0o777 == 0o640
    assert (tmp_path / "d").stat().st_mode & 0o777 == 0o750


def test_file_follows_a_link(tmp_path):
    (tmp_path / "real").write_bytes(b"old")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    with atomic_file(tmp_path / "link") as stream:
        stream.write(b"new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_bytes() == b"new"


def test_devices_and_folders_are_refused_as_files(tmp_path):
    for path in ("/dev/null", tmp_path):
        with pytest.raises(FileError, match="not a regular file"), atomic_file(path):
            pass


def test_file_below_a_file_is_refused(tmp_path):
    (tmp_path / "f").write_bytes(b"")
    with pytest.raises(FileError, match="cannot write"), atomic_file(tmp_path / "f" / "g"):
        pass


def test_folder_appears_at_the_end(tmp_path):
    target = tmp_path / "p" / "out"
    with atomic_folder(target) as folder:
        (folder / "a").write_text("1")
        assert not target.exists()
    assert names(target) == ["a"]
    assert names(tmp_path / "p") == ["out"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, Stop])
def test_interrupted_folder_leaves_nothing(tmp_path, error):
    def write():
        with atomic_folder(tmp_path / "p" / "out") as folder:
            (folder / "a").write_text("1")
            raise error

    with pytest.raises(error):
        write()
    assert names(tmp_path) == []


def test_empty_folder_is_filled_without_overwrite(tmp_path):
    (tmp_path / "out").mkdir()
    with atomic_folder(tmp_path / "out") as folder:
        (folder / "a").write_text("1")
    assert names(tmp_path / "out") == ["a"]


def test_finished_folder_is_kept_unless_overwriting_is_asked_for(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "a").write_text("old")
    with pytest.raises(FileError, match="finished output"), atomic_folder(out, replaceable=("a",)):
        pass
    with pytest.raises(KeyboardInterrupt), atomic_folder(out, overwrite=True, replaceable=("a",)):
        raise KeyboardInterrupt
    assert (out / "a").read_text() == "old"
    with atomic_folder(out, overwrite=True, replaceable=("a", "b")) as folder:
        (folder / "b").write_text("new")
    assert names(out) == ["b"]
    assert names(tmp_path) == ["out"]


def test_folder_with_other_files_is_never_replaced(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "thesis.tex").write_text("x")
    with pytest.raises(FileError, match=r"holds other files, which would be lost: thesis\.tex"):
        check_output_folder(out, overwrite=True, replaceable=("a", "*.png"))
    assert names(out) == ["thesis.tex"]


def test_folder_that_was_filled_meanwhile_is_kept(tmp_path):
    out = tmp_path / "out"

    def write():
        with atomic_folder(out):
            out.mkdir()
            (out / "other").write_text("x")

    with pytest.raises(FileError, match="holds a finished output"):
        write()
    assert names(out) == ["other"]
    assert names(tmp_path) == ["out"]


def test_a_file_in_the_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "out").write_text("x")
    with pytest.raises(FileError, match="a file of that name exists"), atomic_folder(tmp_path / "out"):
        pass
    with pytest.raises(FileError, match="Not a directory"), atomic_folder(tmp_path / "out" / "in"):
        pass


def test_the_working_folder_is_not_replaced(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, reason in ((".", "working folder"), ("", "a name is needed"), (str(tmp_path), "working folder")):
        with pytest.raises(FileError, match=reason), atomic_folder(name):
            pass
    assert os.listdir(tmp_path) == []
