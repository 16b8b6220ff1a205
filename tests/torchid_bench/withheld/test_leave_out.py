"""Every effect in turn is planted, and its diagnosis must do without it."""

import pytest

from tests.torchid_bench.withheld import fakes
from tests.torchid_bench.withheld.fakes import answer, entry
from torchid.effects.registry import KINDS
from torchid.errors import TorchidError
from torchid_bench.benchmarks.withheld_left_out import main
from torchid_bench.withheld import run as running

STRIBECK = answer("explained", entry("stribeck_friction", "sign", 2))
VISCOUS = answer("explained", entry("viscous_friction", "speed", 2))
SAID = {
    "coulomb_friction-1": STRIBECK,
    "coulomb_friction-2": VISCOUS,
    "backlash-1": answer("detected_unexplained"),
    "backlash-2": answer("error"),
}


@pytest.fixture
def asked(plant, monkeypatch):
    """Cases of one planted effect without a simulation, answered by hand; the jobs done."""
    done = []

    def draw(seed, number, *, kind, effects):
        assert kind == "single"
        done.append((seed, number, *effects))
        return effects[0]

    def simulate(name):
        log = fakes.simulate_case(fakes.Spec(0, 0))
        effect = {"name": name, "family": KINDS[name].family, "joints": [2], "size": 5.0}
        return fakes.Simulated(log.urdf, log.columns, {"kind": "single", "effects": [effect]})

    def said(job):
        _, effect, number = job.case.split("-")
        assert set(KINDS) - set(job.settings.effects) == {effect}
        return dict(SAID[f"{effect}-{number}"])

    plant.draw_case, plant.simulate_case = draw, simulate
    monkeypatch.setattr(running, "_answer", said)
    return done


def test_the_verdicts_are_counted(asked, tmp_path, capsys):
    names = ("coulomb_friction", "backlash")
    main(out=tmp_path / "out", seed=3, effects=names, per_effect=2, jobs=1)
    text = capsys.readouterr().out
    for line in (
        "| confident_wrong | 1 of 3 (",  # an error proves nothing
        "| right_family | 1 of 3 (",
        "| detected_unexplained | 1 of 3 (",
        "| hedged | 0 of 3 (",
        "| 3-coulomb_friction-2 | confident_wrong | explained |",
        "| 3-backlash-2 | error | error |",
    ):
        assert line in text
    assert "3-coulomb_friction-1 |" not in text
    assert "| coulomb_friction | 1 | 0 | 0 | 1 | 0 | 0 | 0 |" in text


def test_cases_are_all_different_and_simulated_once(asked, tmp_path):
    given = {"out": tmp_path / "out", "effects": ("coulomb_friction", "backlash"), "per_effect": 2}
    main(**given, seed=3, jobs=1)
    assert len({number for _, number, _ in asked}) == 4
    main(**given, seed=3, jobs=1)
    assert len(asked) == 4
    main(**given, seed=4, jobs=1)
    assert [seed for seed, _, _ in asked] == [3] * 4 + [4] * 4


@pytest.mark.parametrize(
    ("effect", "words"),
    [
        ("air_drag", "unknown effect"),
        # The plant is written on its own: an effect may be torchid's alone.
        ("position_dependent_friction", "plant has no effect 'position_dependent_friction'"),
    ],
)
def test_an_effect_that_cannot_be_left_out_is_refused(asked, tmp_path, effect, words):
    with pytest.raises(TorchidError, match=words):
        main(out=tmp_path / "out", seed=3, effects=(effect,))
    assert not (tmp_path / "out").exists()
