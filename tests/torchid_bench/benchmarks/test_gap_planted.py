"""What is planted is a cause; and what counts as right in each class."""

import json
from pathlib import Path
from typing import Any

import pytest
import torch

from tests.arms import arm
from torchid.effects.base import Effect, Motion
from torchid.effects.periodic import Cogging, PositionDependentFriction
from torchid.effects.spring import JointSpring
from torchid.robot.library import load_robot
from torchid_bench.benchmarks import gap_planted
from torchid_bench.benchmarks.gap_plant import Planted, Scene, generator
from torchid_bench.benchmarks.gap_planted import counted, drawn, well_posed
from torchid_bench.benchmarks.planted_cases import SOURCES, unpack


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Joints of 3r that travel one radian."""
    q = torch.linspace(0, 1, 50, dtype=torch.float64).unsqueeze(1).repeat(1, 3)
    motion = Motion(q, torch.ones_like(q), torch.zeros_like(q))
    return Scene(arm("3r"), (), (0.0,), (motion,), torch.ones(3, dtype=torch.float64))


def planted(effect: Effect, values: list[float], size: float = 2.0) -> Planted:
    return Planted(effect, values, size, effect.joints)


@pytest.mark.parametrize("kind", [Cogging, PositionDependentFriction])
def test_a_joint_passes_through_a_whole_period_of_a_wave(
    scene: Scene, kind: type[Cogging | PositionDependentFriction]
) -> None:
    assert not well_posed(scene, planted(kind(0, 6.2), [1.0, 0.5]))
    assert well_posed(scene, planted(kind(0, 6.3), [1.0, 0.5]))


def test_no_spring_pushes_and_nothing_is_of_size_zero(scene: Scene) -> None:
    assert well_posed(scene, planted(JointSpring(0), [1.0, -5.0]))
    assert not well_posed(scene, planted(JointSpring(0, 1.0), [-1.0, 0.0]))
    assert not well_posed(scene, planted(JointSpring(0), [1.0, 0.0], size=1e-9))


def test_what_is_no_cause_is_drawn_again(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    numbers = iter([1.0, 2.0, 7.0, 9.0])

    def plant(*args: Any, **given: Any) -> Planted:
        return planted(Cogging(0, next(numbers)), [1.0, 0.0])

    monkeypatch.setattr(gap_planted, "plant", plant)
    found = drawn(scene, "cogging", 2.0, generator("test"), 0)
    assert found is not None
    assert found.effect == Cogging(0, 7.0)
    numbers = iter([1.0] * gap_planted.DRAWS)
    assert drawn(scene, "cogging", 2.0, generator("test"), 0) is None


def answer(*names: dict[str, Any]) -> dict[str, Any]:
    usual = {"joints": [1], "how_sure": 0.95, "ambiguous_with": []}
    every = ({**usual, **name} for name in names)
    which = [{"probabilities": {n["effect"]: n["how_sure"]}} | n for n in every]
    return {"status": "explained", "which": which}


@pytest.mark.parametrize(
    ("known", "names", "right"),
    [
        ("decidable", [{"effect": "cogging"}], 1),
        ("decidable", [{"effect": "joint_spring"}, {"effect": "cogging"}], 0),
        ("ambiguous", [{"effect": "joint_spring", "ambiguous_with": ["cogging"]}], 1),
        ("ambiguous", [{"effect": "joint_spring", "ambiguous_with": ["cogging", *"abc"]}], 0),
        ("undecidable", [], 1),
        ("below", [{"effect": "cogging"}], 0),
    ],
)
def test_what_is_right_in_each_class(known: str, names: list[dict[str, Any]], right: int) -> None:
    key = {"effect": "cogging", "joints": [0], "felt_by": [0], "size": 2.0}
    case = {"planted": key, "answer": answer(*names)}
    counts = counted(case, answer(), known)
    kind = "silent" if known in ("undecidable", "below") else known
    assert counts[kind] == 1
    assert counts[f"right {kind}"] == right


def test_names_above_nine_tenths_are_counted_once() -> None:
    key = {"effect": "cogging", "joints": [0], "felt_by": [0], "size": 2.0}
    case = {"planted": key, "answer": answer({"effect": "cogging"}, {"effect": "payload"})}
    counts = counted(case, answer({"effect": "payload"}), "decidable")
    assert (counts["sure"], counts["sure and right"], counts["false"]) == (1, 1, 0)


@pytest.mark.parametrize("label", SOURCES)
def test_the_stored_classes_have_their_models(label: str, tmp_path: Path) -> None:
    unpack(label, tmp_path)
    robot = load_robot(str(tmp_path / "model.yaml"))
    assert robot.knowledge is not None
    left = json.loads((tmp_path / "none.json").read_text())["how_far"]["per_joint"]
    assert len(left) == robot.n
