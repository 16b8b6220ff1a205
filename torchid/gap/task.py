"""What a search is about, and its candidates."""

from dataclasses import dataclass

from torchid.effects.registry import KINDS
from torchid.effects.transient import Contact
from torchid.gap.bank import Bank, composite
from torchid.gap.candidates import Evaluator, all_banks
from torchid.gap.problem import BASE, FRICTION, LINK, Term, term_of
from torchid.identification.base_parameters import BaseParameters
from torchid.robot.inertia import PARAMETERS_PER_LINK, paper_order


@dataclass(frozen=True)
class Task:
    """What a search is about; everything but the model.

    Attributes:
        base: rigid base parameters of the robot.
        names: effects to look for.
        background: effects that are always fitted, on every joint, with the base parameters.
        free: whether base parameters are always fitted.
        inertial: whether corrections of the links' parameters compete.
        own_velocity, age: what the log holds.
        whitened: as Problem's.
        most: effects at most.
        alpha, seed: as Problem's.
        only: as GapSettings'.
    """

    base: BaseParameters
    names: tuple[str, ...]
    background: tuple[str, ...]
    free: bool
    inertial: bool
    own_velocity: bool
    age: bool
    whitened: bool
    most: int
    alpha: float
    seed: int
    only: tuple[tuple[str, int | None], ...] | None = None

    def allows(self, bank: Bank) -> bool:
        """Whether a bank is one of the candidates."""
        if self.only is None:
            return True
        effects = bank.members[0] if bank.members else ()
        return any(
            bank.name == name
            and (joint is None or (len(effects) == 1 and joint in effects[0].joints))
            for name, joint in self.only
        )

    @property
    def independent(self) -> list[int]:
        """Numbers, link by link, of the parameters that stand for the base parameters."""
        order = paper_order(self.base.n_rigid_parameters // PARAMETERS_PER_LINK)
        return order[list(self.base.independent[: self.base.n_rigid])].tolist()


def banks_of(evaluator: Evaluator, task: Task) -> list[Bank]:
    """All candidates at a model."""
    names = [n for n in task.names if n not in (LINK, "payload")]
    banks = list(all_banks(evaluator, names, own_velocity=task.own_velocity, age=task.age))
    plain = {(b.name, b.place): b for b in banks}
    for j in range(evaluator.n):
        pair = [plain.get((name, j)) for name in FRICTION.split("+")]
        if all(pair):
            banks.append(composite(FRICTION, pair))  # type: ignore[arg-type]
    if Contact.name in task.names:
        banks.append(evaluator.contact_bank(evaluator.residual()))
    return [bank for bank in banks + rigid_banks(evaluator, task) if task.allows(bank)]


def rigid_banks(evaluator: Evaluator, task: Task) -> list[Bank]:
    """Payload, links and all base parameters, from one regressor."""
    n = evaluator.n
    banks = []
    if "payload" in task.names:
        banks.append(evaluator.link_bank(KINDS["payload"](), n - 1))
    if task.inertial and not task.free:
        if LINK in task.names:
            banks += [evaluator.link_bank(KINDS[LINK](link), link) for link in range(n)]  # type: ignore[call-arg]
        banks.append(evaluator.rigid_bank(BASE, (), task.independent))
    return banks


def fixed_terms(evaluator: Evaluator, task: Task) -> tuple[Term, ...]:
    """Terms that are always in the model."""
    if not task.free:
        return ()
    terms = [term_of(evaluator.rigid_bank(BASE, (), task.independent))]
    for name in task.background:
        for j in range(evaluator.n):
            terms.append(term_of(evaluator.joint_bank(KINDS[name], j)))  # type: ignore[arg-type]
    return tuple(terms)
