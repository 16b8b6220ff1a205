"""An earlier log beside the one that is asked: what has changed, and what was lacking already.

Of a model that was made from an earlier log a cause is one of three: absent, in both logs, for the
model lacked it then, or new. Both logs are fitted together. What the model is made of, base
parameters and its own effects, is a nuisance over both, of which nothing is known beforehand: the
earlier log itself says what the model's covariance would say, and nothing counts twice. Each
candidate has a column over both logs and one that is zero on the earlier one, at one price. Noise
is pooled by itself, for a joint has one size and one correlation of what is left over both.
"""

from dataclasses import replace
from functools import cached_property
from typing import Literal

import numpy as np
import torch

from torchid.effects.base import Effect
from torchid.gap.causes.candidates import Library, Term
from torchid.gap.causes.evidence import Fit
from torchid.identification.knowledge import between_sessions, known_names
from torchid.results.cause import When
from torchid.robot.knowledge import Knowledge

KNOWN = 1e-3
"""Share of a candidate's squares beyond the model's own columns below which it is one of them, and
in the earlier log below which that log does not show it [1]."""

NEW: When = "new"
BOTH: When = "in both"
"""Of a term: whether it acts in the log that is asked alone, or in the earlier one as well."""


class TwoLogs(Library):
    """All candidates for the gap of a model on a log, beside an earlier log.

    Args:
        problem: over both logs.
        events, at: as a library's.
    """

    def _nuisance(self) -> Term | None:
        """What the model is made of, over both logs, and how much its friction changes from one
        session to the next by itself; of a model that does not say how sure it is, as always."""
        wanted = self.problem.wanted
        if wanted.free or wanted.background or wanted.knowledge is None:
            return super()._nuisance()
        made, changes = self._free(self._own), between_sessions(self.problem.robot)
        # Friction of one session differs from that of another by itself: a column of each
        # coefficient that is zero on the earlier log, as wide as sessions differ.
        columns, std = [made.columns], np.diagonal(made.spread).tolist()
        for effect in self._own:
            own = [changes.get(name, 0.0) for name in known_names(effect)]
            if any(own):
                columns.append(self.columns.on_all_joints(effect).numpy() * self.keep * self.asked)
                std += np.sqrt(own).tolist()
        return self._always(np.concatenate(columns), np.array(std))

    @property
    def unexplained(self) -> np.ndarray:
        """Nothing: the log that the model was made from says what it lacked."""
        return np.zeros(self.n)

    @property
    def _own(self) -> list[Effect]:
        """Effects of the model."""
        return [e for e, _ in self.problem.given.model.effects if not e.event]

    def known(self, fit: Fit) -> Knowledge | None:
        """What is known of the model where it has to give way for what both logs have: its
        covariance was made without that."""
        wanted = self.problem.wanted
        if wanted.free or wanted.knowledge is None:
            return wanted.knowledge
        names = [name for e in self._own for name in known_names(e)]
        known = wanted.knowledge.over(names)
        change, base = np.zeros(known.root.shape[1]), list(wanted.base.by_link)
        # Coefficients of the nuisance are base parameters first, then those of the model's own
        # effects.
        change[[*base, *range(known.rigid, len(change))]] = fit.x[: len(base) + len(names)]
        return known.shifted(torch.from_numpy(change))

    @cached_property
    def _spanned(self) -> np.ndarray:
        """Orthonormal directions (n N, K) of what the model is made of, each joint in units of its
        gap."""
        assert self.nuisance is not None
        columns = self.nuisance.columns / self.size[:, None]
        flat = columns.reshape(len(columns), -1)
        flat = flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-300)
        # Columns that others make as well have nothing on the diagonal.
        q, r = np.linalg.qr(flat.T)
        shows = np.abs(np.diagonal(r)) > 1e-8
        return q[:, shows]

    def _is_the_models(self, term: Term) -> bool:
        """Whether a term over both logs is what the model is made of."""
        if self.nuisance is None:
            return False
        axes = self._spanned
        if term.place is None:
            own = (term.columns / self.size[:, None]).reshape(term.count, -1)
        else:
            axes = axes.reshape(self.n, -1, axes.shape[1])[term.place]
            own = term.columns / self.size[term.place]
        left = (own**2).sum() - ((own @ axes) ** 2).sum()
        return bool(left < KNOWN * (own**2).sum())

    def offered(self, terms: list[Term]) -> list[Term]:
        """Each candidate over both logs, unless the model has it, and as a new one; of what the
        earlier log does not show nothing is said of when it came."""
        out = []
        for term in terms:
            whole = float((term.columns**2).sum())
            shown = whole - float(((term.columns * self.asked) ** 2).sum()) > KNOWN * whole
            sides: list[When | Literal[""]] = [BOTH, NEW] if shown else [""]
            if term.effect is not None and term.effect.event:
                sides = [NEW]  # what happened once happened in one log
            # Of what the model is made of only a change can be a cause.
            if sides != [NEW] and self._is_the_models(term):
                sides = sides[1:]
            for since in sides:
                key = (since, *term.key) if since else term.key
                out.append(self._zeroed(replace(term, since=since, key=key)))
        return [t for t in out if t.columns.any()]

    def like(self, made: Term, term: Term) -> Term:
        """What was made from an effect, as what it is another shape of."""
        return self._zeroed(super().like(made, term))

    def _zeroed(self, term: Term) -> Term:
        """A term, zero on the earlier log if it is new."""
        if term.since != NEW:
            return term
        before = None if term.rare else term.columns[..., ~self.asked].copy()
        return replace(term, columns=term.columns * self.asked, before=before)
