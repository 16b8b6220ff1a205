"""Knowledge adds up, ages, forgets, and is written and read back."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.testing import assert_close

from torchid.errors import RobotError
from torchid.robot.knowledge import Knowledge, from_mapping, to_mapping
from torchid.robot.library import load_robot
from torchid.robot.writer import write_robot

NAMES = ("viscous_friction Fv1", "coulomb_friction Fc1", "torque_offset F01")


def drawn(seed: int, rows: int = 40, names: tuple[str, ...] = NAMES, links: int = 1) -> Knowledge:
    """Rows of columns of very different sizes, as parameters in kg and kg m^2 have."""
    generator = torch.Generator().manual_seed(seed)
    size = 10 * links + len(names)
    root = torch.randn(rows, size, generator=generator, dtype=torch.float64)
    return Knowledge(links, names, root * 10.0 ** torch.linspace(-3, 3, size), (f"run {seed}",))


@given(st.integers(0, 10**6))
@settings(max_examples=30)
def test_sessions_one_by_one_are_all_at_once(seed: int) -> None:
    parts = [drawn(seed + k, rows=5) for k in range(6)]
    one_by_one = parts[0]
    for part in parts[1:]:
        one_by_one = one_by_one.plus(part)
    every = Knowledge(1, NAMES, torch.cat([p.root for p in parts]))
    size = every.information.diagonal().sqrt()
    unit = size * size.unsqueeze(1)
    assert_close(one_by_one.information / unit, every.information / unit, rtol=1e-8, atol=1e-10)
    assert len(one_by_one.sources) == 6


def test_what_is_asked_for_is_known_whatever_the_others_are() -> None:
    known = drawn(1)
    covariance = torch.linalg.inv(known.information)
    for name in NAMES:
        at = 10 + NAMES.index(name)
        assert known.std(name) == pytest.approx(float(covariance[at, at]) ** 0.5, rel=1e-8)
    # In another order, with a new one: the same covariance, and nothing of the new one.
    part = known.over((NAMES[2], "rotor_inertia Ia1", NAMES[0]))
    kept = [*range(10), 12, 10]
    own = part.information[[*range(11), 12]][:, [*range(11), 12]]
    assert_close(torch.linalg.inv(own), covariance[kept][:, kept], rtol=1e-7, atol=1e-12)
    assert part.std("rotor_inertia Ia1") == torch.inf


def test_what_has_changed_is_not_known_any_more() -> None:
    known = drawn(2)
    covariance = torch.linalg.inv(known.information)
    forgot = known.without([NAMES[1]])
    assert forgot.std(NAMES[1]) == torch.inf
    assert forgot.std(NAMES[0]) == pytest.approx(float(covariance[10, 10]) ** 0.5, rel=1e-8)
    moved = drawn(2, links=2).without((), links=[1])
    assert float(moved.root[:, 10:20].abs().max()) == 0.0


@pytest.mark.parametrize("told", [True, False])
def test_of_a_link_and_its_load_the_sum_is_known(told: bool) -> None:
    """As well as their covariance says; or, where nothing but a log told of the load, whose columns
    are the link's, as well as the log says."""
    load = tuple(f"payload p{k}" for k in range(10))
    known = drawn(3, names=(NAMES[0], *load, NAMES[1]), rows=60)
    if not told:
        root = known.root.clone()
        root[:, 11:21] = root[:, :10] * (1 + 1e-13)
        known = replace(known, root=root)
    merged = known.merged(load, 0)
    assert merged.coefficients == (NAMES[0], NAMES[1])
    kept = [*range(11), 21]
    information = known.information[kept][:, kept]
    if told:
        sums = torch.eye(22, dtype=torch.float64)[kept]
        sums[:10, 11:21] = torch.eye(10, dtype=torch.float64)
        information = torch.linalg.inv(sums @ torch.linalg.inv(known.information) @ sums.T)
    size = information.diagonal().sqrt()
    unit = size * size.unsqueeze(1)
    assert_close(merged.information / unit, information / unit, rtol=1e-6, atol=1e-8)


def test_ageing_adds_a_variance() -> None:
    known = drawn(3)
    aged = known.aged({NAMES[0]: 4.0, "unknown": 1.0})
    expected = torch.linalg.inv(known.information)
    expected[10, 10] += 4.0
    assert_close(torch.linalg.inv(aged.information), expected, rtol=1e-7, atol=1e-12)


def test_ageing_of_what_is_hardly_known() -> None:
    """The inverse covariance may be singular: only a sum of two is known here."""
    root = torch.zeros(1, 13, dtype=torch.float64)
    root[0, 10] = root[0, 11] = 2.0
    aged = Knowledge(1, NAMES, root).aged({NAMES[0]: 0.75})
    assert_close(aged.information[10, 11], torch.tensor(1 / (0.25 + 0.75)).double())
    assert aged.std(NAMES[0]) == torch.inf


def test_written_and_read_back(tmp_path: Path) -> None:
    robot = load_robot("3r")
    known = replace(
        drawn(4, names=("viscous_friction Fv2",), links=3),
        left=torch.tensor([0.1, 0.2, 0.3]).double(),
        between={"viscous_friction Fv2": 0.04},
        log=("arm.rows.npz", "0" * 64),
    )
    write_robot(replace(robot, knowledge=known), tmp_path / "arm.yaml")
    again = load_robot(tmp_path / "arm.yaml").knowledge
    assert again is not None
    assert again.coefficients == known.coefficients
    assert again.sources == known.sources
    assert bool((again.root == known.root).all())
    assert known.left is not None
    assert again.left is not None
    assert again.left.tolist() == known.left.tolist()
    assert again.between == known.between
    assert again.log == known.log
    # What several logs know together is none of them.
    assert again.plus(known).log is None
    assert load_robot("3r").knowledge is None


def test_the_most_that_a_model_has_left_is_known() -> None:
    first, second = (
        replace(drawn(k, links=3), left=torch.tensor(left, dtype=torch.float64))
        for k, left in ((1, [0.1, 0.5, 0.2]), (2, [0.3, 0.4, 0.2]))
    )
    both = first.plus(second)
    assert both.left is not None
    assert both.left.tolist() == [0.3, 0.5, 0.2]
    assert drawn(1).plus(drawn(2)).left is None


def test_other_parameters_are_not_known() -> None:
    robot = replace(load_robot("3r"), knowledge=drawn(5, links=3))
    assert robot.with_parameters(robot.parameters).knowledge is None
    assert robot.with_payload(1.0).knowledge is robot.knowledge


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"rows": ["1 2 3"]}, "wrong size"),
        ({"rows": ["1 two"]}, "not a number"),
        ({"rows": [[1.0]]}, "list of texts"),
        ({"rows": ["nan " * 13]}, "not all finite"),
        ({"coefficients": [NAMES[0]] * 2}, "named twice"),
        ({"of": []}, "unknown key"),
        ({"left": ["0.1", "0.2"]}, "wrong size"),
        ({"between_sessions": ["Fv2"]}, "not a number"),
        ({"log": ["arm.rows.npz"]}, "SHA-256"),
    ],
)
def test_a_damaged_file_is_one_error(change: dict[str, object], said: str) -> None:
    data = {**to_mapping(drawn(6)), **change}
    with pytest.raises(RobotError, match=said):
        from_mapping(data, 1, "arm.yaml")
