"""From logs of commands and positions to named causes.

    pose -> Problem | search -> Answered | how well known -> Equations | check -> Checked | describe

Everything that is reported belongs to one model, the answered one: its numbers are fitted on all
motions, and how far it goes is judged on motions that it was not fitted on.
"""

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import torch

from torchid.effects.servo import INDEX, PARAMETERS
from torchid.log.model import Log
from torchid.parallel.pace import Pace
from torchid.position.answered import SEVERAL, Answered, as_the_file, best_answer
from torchid.position.checked import check, errors_of_motions, errors_of_regimes
from torchid.position.data import WINDOW_S, PositionData
from torchid.position.diagnosis import PositionDiagnosis
from torchid.position.effects import CORE
from torchid.position.equal import pooled, with_data_sheets
from torchid.position.file_servos import changes_of, with_files_scale
from torchid.position.findings import describe_findings
from torchid.position.fit import NOISE
from torchid.position.judge import Equations, equations, value_interval
from torchid.position.known_numbers import doubt_of
from torchid.position.model import ServoArm
from torchid.position.problem import MOST_WINDOWS, Problem, pose, some_of
from torchid.position.record import KnownRecord
from torchid.position.replay import accuracy
from torchid.position.search import plain
from torchid.position.servo_model import Motions, ServoModel
from torchid.position.untestable import not_testable
from torchid.results.answer import Answer
from torchid.results.cause import JudgedOn
from torchid.robot.model import Robot
from torchid.simulation.servo import Servos
from torchid.simulation.servo_loop import windows_of
from torchid.statistics.criteria import UNSURE_SCALE, WORTHWHILE
from torchid.typing import Bool, Tensor

STAGES = {
    "checking the log": 1, "a plain servo": 11, "a load": 6, **SEVERAL,
    "what each effect is worth": 11, "how far it goes": 8,
}  # fmt: skip
"""That are told as progress, with about the share of the time that each takes [1]."""
MUST = ("a plain servo", "what each effect is worth", "how far it goes")
"""Those without which there is no answer."""


def diagnose_positions(
    robot: Robot,
    log: Log,
    *,
    held_out: Log | None = None,
    trusted: bool = False,
    types: Sequence[str] = (),
    sheets: Sequence[Mapping[str, float]] = (),
    start: ServoArm | None = None,
    worthwhile: float = WORTHWHILE,
    pace: Pace | None = None,
    watch: Callable[[Answer], None] | None = None,
) -> PositionDiagnosis:
    """Which causes part an arm's positions from its commands, and how far that goes.

    Args:
        robot: gravity of its masses tells torques from ratios. Where it has none, its links are
            taken for rods, and all torques are told in their ratios.
        log: t, q and u of several motions; of one alone nothing can be held out but its parts.
        held_out: motions that take part in nothing but the judgement.
        trusted: whether the masses of the robot's file are right; else they are known as files are,
            and all torques with them.
        start: the arm that the robot's own file describes. Where its servos follow all joints
            nothing is sought; else what is found is held against them.
        types: of the joints' servos: those of one name are units of one type.
        sheets: what their makers say of them, values by parameter.
        worthwhile: least share of a joint's error by which a cause must lower it to be named.
        pace: hears which of `STAGES` begins, and says how much time there is.
        watch: called with an `Answer` of status `searching`, without causes, where a search begins.

    Returns:
        The answer; its `corrected` arm is what `torchid.replay` moves.

    Raises:
        LogError: no commands, other joints than the robot's, uneven sampling, or too short a log.
    """
    robot.require_fixed_base("a diagnosis of positions")
    begun, pace = time.perf_counter(), pace or Pace(None, STAGES)
    pace("a plain servo")
    problem = pose(robot, log, start, worthwhile)
    problem = replace(problem, trusted=trusted, types=types, sheets=sheets)
    answered = as_the_file(problem) or best_answer(problem, pace, watch)
    pace("how far it goes")
    answered, known, odd = _how_well_known(answered, problem)
    result = _described(answered, known, problem)
    if held_out is not None:
        servos = problem.given or problem.plain.servos
        given = replace(result.corrected, robot=problem.data.robot, servos=servos, std=None)
        before, after = (
            accuracy(arm, held_out, ~problem.data.still) for arm in (given, result.corrected)
        )
        judged = JudgedOn.by_names(held_out.names, "held out")
        result = replace(result, held_out=(before, after), judged=judged)
    seconds = time.perf_counter() - begun
    return replace(result, warnings=problem.warnings + odd, seconds=seconds)


def _how_well_known(
    answered: Answered, problem: Problem
) -> tuple[Answered, Equations, tuple[str, ...]]:
    """The answered model beside what makers say of its servos, and where those of one type are
    drawn together; its equations there; and a sentence for each joint that is not of its type."""
    data, model = answered.motions.data, answered.model
    more, odd = problem.more.windows, tuple[str, ...]()
    known = equations(data, model.servos, model.free, more, trusted=problem.trusted)
    if problem.file is not None and data.weighed:
        known = with_files_scale(known, problem.file.model.servos)
    if any(problem.sheets):
        known = with_data_sheets(known, problem.sheets, ~data.still)
    if len(set(problem.types) - {""}) and data.weighed:
        known, odd = _of_one_type(answered, known, problem.types)
    model = replace(model, servos=known.servos)
    return replace(answered, model=model), known, odd


def _of_one_type(
    answered: Answered, known: Equations, types: Sequence[str]
) -> tuple[Equations, tuple[str, ...]]:
    """Joints of one type drawn together, with a sentence for each that would then follow worse: it
    stays as it was fitted."""
    kinds, odd, few = list(types), list[str](), answered.motions
    moves, before = ~few.data.still, few.losses(known.servos).sum(0)
    for _ in types:
        drawn = pooled(known, kinds, moves)
        # What is left over of the small steps that equations do not know of.
        fitted = replace(answered.model, servos=drawn.servos).fitted(few, 1)
        rise = (fitted.losses(few) / before.clamp(min=1e-300)).sqrt() - 1
        j = int((rise * moves).argmax())
        if not float(rise[j] * moves[j]) > WORTHWHILE or not kinds[j]:
            return replace(drawn, servos=fitted.servos), tuple(odd)
        odd.append(
            f"joint {j + 1} is not like the others of type {kinds[j]}: with their numbers its "
            f"error grows by {100 * float(rise[j]):.0f} %, so it keeps its own."
        )
        kinds[j] = ""
    return known, tuple(odd)


def _described(answered: Answered, known: Equations, problem: Problem) -> PositionDiagnosis:
    """The answer: where, which, how far, and what this log could not show."""
    data, servos, start = answered.motions.data, answered.model.servos, problem.start
    believed = problem.believed
    checked, still = check(answered, problem, known), problem.data.still
    ratio_only, unanchored = _ratios_alone(answered, known, problem)
    unknown = still | ratio_only
    kp, std = servos.of("kp"), known.deviations()[:, known.names.index("kp")]
    ends = zip(kp.tolist(), std.tolist(), strict=True)
    expected = known.expected()
    interval = torch.tensor([value_interval("kp", *each) for each in ends])
    return PositionDiagnosis(
        data=data,
        servos=servos,
        findings=describe_findings(answered, known, problem, checked, ratio_only),
        gains=(
            kp.masked_fill(unknown, torch.nan),
            interval.masked_fill(unknown[:, None], torch.nan),
        ),
        ratio_only=ratio_only,
        unanchored=unanchored,
        commanded=checked.commanded,
        plain_servo=checked.simple,
        answered=checked.answered,
        file=checked.file,
        regimes=errors_of_regimes(data, *checked.errors),
        judged=JudgedOn.by_names(data.log.names, "left out in turn"),
        motions=(data.log.names, errors_of_motions(data, checked.errors[1])),
        errors=checked.errors,
        still=still,
        warnings=problem.warnings,
        not_testable=not_testable(answered.motions, known, ~still),
        closed_ci95=checked.closed_ci95,
        noise=problem.noise,
        known=tuple(
            KnownRecord(
                joint=j,
                names=tuple(itertools.compress(known.names, on)),
                covariance=expected[j][on][:, on],
            )
            for j, on in enumerate(known.mask & ~still[:, None])
        ),
        as_given=None if problem.file is None else problem.file.near & ~problem.doubted,
        changes=()
        if start is None or believed is None
        else changes_of(start, believed.servos.of("kp"), known, ratio_only, still),
        file_doubt="" if start is None else doubt_of(start.servos, problem.gains, kp, unknown),
    )


def _ratios_alone(
    answered: Answered, known: Equations, problem: Problem
) -> tuple[Bool[Tensor, " n"], Bool[Tensor, " n"]]:
    """Joints of which torques are known up to one factor; and those of them of which neither a load
    nor a known gain tells it, but for what a file's masses are unsure by."""
    data, by_file = answered.motions.data, answered.by_file
    none = torch.zeros_like(data.still)
    # The file's gain and masses are the scale; the log refutes a gain beside masses alone.
    free = none if data.weighed or by_file is None else ~by_file
    # Where the file's other numbers are followed as they are, they are the scale of a gain.
    sought = problem.file is None or by_file is not None
    without = ~none if problem.file is None else problem.doubted & sought
    if not bool(without.any()):
        return free, free
    k = known.names.index("kp")
    # Torques are searched as shares of kp, so that kp alone is that factor.
    unloaded = known.gram.sum(0)[:, k, k] / known.alike < (NOISE / UNSURE_SCALE) ** 2
    of_type = none | torch.tensor([bool(kind) for kind in problem.types or [""]])
    of_sheet = none | torch.tensor(["kp" in sheet for sheet in problem.sheets or [{}]])
    std = known.deviations()[:, k]
    by_log = (std.square() - known.torque_std.square()).clamp(min=0).sqrt()
    unanchored = (unloaded & ~of_type & ~of_sheet) | (not data.weighed) | (by_log > UNSURE_SCALE)
    ratios = unanchored | (std > UNSURE_SCALE)
    return torch.where(without, ratios, free), torch.where(without, unanchored, free)


def refitted(arm: ServoArm, data: PositionData, *allowed: Servos) -> tuple[ServoArm, ...]:
    """The arm with servos that have some parameters alone, fitted to a log.

    Args:
        arm: whose servos may have more.
        data: of the same robot, from `prepare`.
        allowed: the arm's own servos without what may not be, once for each of the answers: the
            core is free on all joints, another parameter where they have it.
    """
    motions = Motions(data, some_of(windows_of(data.tracks, WINDOW_S), MOST_WINDOWS))
    used = {p.name: arm.servos.of(p.name) != p.neutral for p in PARAMETERS}
    used |= dict.fromkeys(CORE, torch.ones(data.robot.n, dtype=torch.bool))
    used["damping_share"] = torch.zeros(data.robot.n, dtype=torch.bool)
    core = torch.tensor([p.name in CORE for p in PARAMETERS])
    logs = core & torch.tensor([p.kind == "log" for p in PARAMETERS])
    neutral = torch.tensor([p.neutral for p in PARAMETERS], dtype=torch.float64)
    simple, out = None, []
    for servos in allowed:
        plane, joint = servos.plane, servos.joint
        kept = (joint != neutral) | core
        left = {name: on & kept[:, INDEX[name]] for name, on in used.items()}
        free = {name: on for name, on in left.items() if bool(on.any())}
        # What is searched on a logarithmic scale begins at a number.
        least = 1e-6 * float(joint[:, INDEX["kp"]].max())
        begun = [torch.where(logs, joint.clamp(min=least), joint)]
        if bool((joint != arm.servos.joint).any()) or bool((plane != arm.servos.plane).any()):
            # Where something is missing plain servos may be the better beginning.
            simple = simple or plain(motions)
            begun.append(torch.where(core, simple.servos.joint, joint))
        model = ServoModel(replace(arm.servos, plane=plane), free)
        ends = [model.at(one).fitted(motions, 12) for one in begun]
        best = torch.stack([end.losses(motions) for end in ends]).argmin(0)
        joint = torch.stack([end.servos.joint for end in ends])[best, torch.arange(data.robot.n)]
        out.append(replace(arm, robot=data.robot, servos=model.at(joint).servos, std=None))
    return tuple(out)
