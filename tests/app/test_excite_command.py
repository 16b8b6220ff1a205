"""`torchid excite` from the outside: room, first runs, files for controllers."""

from tests.excitation.shaped import shaped_arm

RANDOM = ("--kind", "random", "--duration", 8, "--max-acceleration", 5)


def test_friction_that_is_known_is_no_news(command, tmp_path):
    arm = shaped_arm("7r", tmp_path, friction=1.0)
    done = command("excite", arm, *RANDOM, "--to", tmp_path / "m.csv")
    assert "largest torque" in done.out
    assert "no friction" not in done.out
