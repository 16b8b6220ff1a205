"""`torchid explain`: one result again, and an index of a folder of them."""

from tests.gap.diagnoses import diagnosis


def test_a_folder_is_listed_and_indexed(command, tmp_path):
    (tmp_path / "results" / "arm").mkdir(parents=True)
    diagnosis().save(tmp_path / "results" / "arm" / "gap.json")
    index = tmp_path / "results" / "index.html"
    for _ in range(2):  # the page of before is no input
        done = command("explain", tmp_path / "results", "--report", index)
        assert done.code == 0, done.err
    assert "1 result below" in done.out
    assert 'href="arm/gap.json"' in index.read_text()


def test_the_only_result_of_the_present_folder_needs_no_name(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "holds no result" in command("explain").err
    (tmp_path / "out").mkdir()
    diagnosis().save(tmp_path / "out" / "gap.json")
    named = command("explain", "out/gap.json")
    assert (named.code, named.out) == (0, command("explain").out)
    assert named.out == command("explain", "out").out
    diagnosis().save(tmp_path / "other.json")
    assert "2 results below ." in command("explain").out
