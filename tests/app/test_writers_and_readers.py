"""Every command reads what another one wrote: a table of writers and readers."""

from pathlib import Path

import pytest

from tests.marks import some

LIMITS = ("--max-velocity", "2", "--max-acceleration", "5")
ROBOTS = (
    "corrected.yaml",
    *(f"{source}_{kind}/3r.{suffix}" for source in ("model", "identified")
      for kind, suffix in (("yaml", "yaml"), ("urdf", "urdf"), ("mjcf", "xml"))),
)  # fmt: skip
READERS = {
    "robot": ("robot", "{robot}"),
    "check": ("check", "{robot}"),
    "simulate": ("simulate", "{robot}", "motion.csv", "--save", "out.parquet"),
    "simulate, noise of the report": (
        "simulate", "{robot}", "motion.csv", "--noise", "paper", "--save", "out.parquet",
    ),
    "simulate under control": (
        "simulate", "{robot}", "motion.csv", "--closed-loop", "--save", "out.csv",
    ),
    "log show": ("log", "show", "run.parquet", "--robot", "{robot}"),
    "log doctor": ("log", "doctor", "{robot}", "run.parquet"),
    "identify": ("identify", "{robot}", "run.parquet"),
    "gap": ("gap", "{robot}", "run.parquet", "--effects", "coulomb_friction", "--out", "again"),
    "excite": (
        "excite", "{robot}", "--kind", "random", "--duration", "4", *LIMITS, "--save", "next.csv",
    ),
    "export yaml": ("export", "{robot}", "--to", "yaml", "--out", "as_yaml", "--overwrite"),
    "export urdf": ("export", "{robot}", "--to", "urdf", "--out", "as_urdf", "--overwrite"),
    "export mjcf": ("export", "{robot}", "--to", "mjcf", "--out", "as_mjcf", "--overwrite"),
}  # fmt: skip
LOGS = ("run.parquet", "mended.parquet", "shown.csv", "simulated.npz")
LOG_READERS = {
    "log show": ("log", "show", "{log}"),
    "log doctor": ("log", "doctor", "3r", "{log}"),
    "identify": ("identify", "3r", "{log}"),
    "gap": ("gap", "3r", "{log}", "--effects", "coulomb_friction"),
    "log show --save": ("log", "show", "{log}", "--save", "again.csv"),
}
RESULTS = ("gap/gap.json", "result/identification.json", "sets/extraction.json", "doctor.json")


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("table")


@pytest.fixture
def written(command, place, monkeypatch):
    """The folder with what every writer wrote."""
    monkeypatch.chdir(place)
    if not Path("corrected.yaml").exists():
        faults = ("coulomb_friction:joint=2,Fc=2.0", "time_delay:joint=1,delay=0.01")
        wanted = "coulomb_friction,time_delay"
        effects = [part for fault in faults for part in ("--effect", fault)]
        lines = [
            "excite 3r --kind random --count 2 --duration 6 --seed 1 --save motion.csv",
            "log show run.parquet --save shown.csv",
            "log doctor 3r run.parquet --apply mended.parquet --json doctor.json",
            "identify 3r run.parquet --out result",
            "extract 3r result/identification.json --method sdp --out sets",
            f"gap 3r run.parquet --effects {wanted} --out gap --save-model corrected.yaml",
            "simulate corrected.yaml motion.csv --save simulated.npz",
        ]
        lines += [
            f"export {result} --to {kind} --out {out}_{kind}"
            for result, out in (("corrected.yaml", "model"), (RESULTS[1], "identified"))
            for kind in ("yaml", "urdf", "mjcf")
        ]
        for k, line in enumerate(lines):
            done = command(*line.split())
            assert done.code == 0, f"{line}\n{done.err}"
            if k == 0:
                simulated = ("simulate", "3r", "motion.csv", *effects, "--rate", "100")
                assert command(*simulated, "--save", "run.parquet").code == 0
    return place


@pytest.mark.parametrize("robot", some(ROBOTS, 2))
def test_every_robot_is_read_by_every_command(command, written, robot):
    for name, line in READERS.items():
        done = command(*(part.format(robot=robot) for part in line), *_again(line))
        assert done.code == 0, f"{name}\n{done.err}"


@pytest.mark.parametrize("log", some(LOGS, 1))
def test_every_log_is_read_by_every_command(command, written, log):
    for name, line in LOG_READERS.items():
        done = command(*(part.format(log=log) for part in line), *_again(line))
        assert done.code == 0, f"{name}\n{done.err}"


@pytest.mark.slow
@pytest.mark.parametrize("result", RESULTS)
def test_every_result_is_explained_and_what_holds_dynamics_exported(command, written, result):
    assert command("explain", result).code == 0
    # A diagnosis is refitted to what a URDF can say, and needs its logs for that.
    kind = "yaml" if "gap" in result else "urdf"
    done = command("export", result, "--to", kind, "--out", "from_result", "--overwrite")
    assert done.code == (1 if result == "doctor.json" else 0), done.err
    if result == "doctor.json":
        assert "carries no dynamics" in done.err


def _again(line):
    """A folder or file of the command before may be written over."""
    return ("--overwrite",) if "--out" in line and "--overwrite" not in line else ()
