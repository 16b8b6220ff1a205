"""Compliance of joints from the resonance of their links, above the band of a fit.

Below its resonance an elastic joint looks rigid; at it the link swings on the gear, and the torque
with it (`effects.gear`). So the spectra of what a model leaves are compared with those that swings
of every frequency and damping would leave, on all joints that feel the link. A torque that is late
or filtered, and a link that lags but is damped too much to swing, are what it must be told from.

Up there the model's torque, which differentiates the positions twice, is half noise. It passes a
Wiener filter first: what stays of it is as much as is signal (Wiener 1949). The likelihood is
Whittle's (1953): the bins of a spectrum are independent, octave by octave as loud as what is left.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from torchid.design.columns import Columns
from torchid.dynamics.regressor import regressor_chunks
from torchid.effects.gear import Gear, joint_load, link_lag
from torchid.effects.instants import shifted
from torchid.effects.variation import rigid_torque
from torchid.log.filtering import extended, fast_length
from torchid.robot.inertia import PARAMETERS_PER_LINK
from torchid.statistics.spectrum import density
from torchid.typing import Bool, Float, Tensor

RATIOS = (0.03, 0.1)
"""Dampings of what swings, relative to the critical one."""

SLUGGISH = (0.3,)
"""Dampings of what lags and does not swing."""

LATE = np.geomspace(0.002, 0.06, 9).tolist()
"""Delays, and time constants of filters, that torques may have [s]."""

LONGEST = 8_000
"""Instants that are looked at: half a minute of motion holds hundreds of swings."""


Signals = list[Float[Tensor, "B _"]]
"""Of every segment."""

Pair = tuple[float, float]
"""Resonance of a link before a held motor, at its mean inertia [Hz], and damping relative to the
critical one."""


@dataclass(frozen=True)
class Swing:
    """A link that swings on its joint's gear.

    Attributes:
        value, std: compliance [rad/(N m); m/N].
        damping: of the gear [N m s/rad; N s/m].
        hertz: resonance before a held motor, at the mean of the inertia.
        explained: share by which it lowers the error above the fit's band, on the joint where most.
        size: RMS of what it explains there, relative to that of the joint's torque there.
    """

    value: float
    std: float
    damping: float
    hertz: float
    explained: float
    size: float

    @property
    def sentence(self) -> str:
        """What it says of the compliance, as a sentence."""
        return (
            f"the link swings at {self.hertz:.2g} Hz before a held motor, which tells "
            f"{self.value:.3g} ± {self.std:.2g} and lowers the error above the fit's band by "
            f"{100 * self.explained:.0f} %"
        )


def swings(columns: Columns, keep: Bool[Tensor, "n N"], alpha: float) -> dict[int, Swing]:
    """Joints, from 0, whose links swing.

    Args:
        columns: at the model whose gap is looked at.
        keep: samples that count for the laws that the gap is freed from first.
        alpha: level of a false one among all joints.
    """
    spectra = _Spectra(columns, keep)
    found: dict[int, Swing] = {}
    # The strongest first: what it explains is no other joint's.
    while spectra.usable and len(found) < columns.n:
        best = _strongest(spectra, found, alpha)
        if best is None:
            break
        joint, pair, std = best
        found[joint] = spectra.taken_out(joint, pair, std)
    return found


def _strongest(
    spectra: "_Spectra", found: dict[int, Swing], alpha: float
) -> tuple[int, Pair, float] | None:
    """The joint whose swing explains most, and the relative standard deviation of its compliance;
    None where something else explains nearly as much."""
    # 0.6: lowest resonance that is tried, in units of the fit's cut-off
    low, high = 0.6 * spectra.samples.cutoff, spectra.top
    # 4: frequencies that are tried
    count = 1 + math.ceil(4 * math.log2(high / low))
    grid = list(itertools.product(np.geomspace(low, high, count).tolist(), RATIOS + SLUGGISH))
    # The best swing of every joint, and the best of all that is none.
    others = [0.0, *spectra.late()]
    best: list[tuple[float, int, Pair]] = []
    for joint in (j for j in range(spectra.n) if j not in found):
        pairs = list(zip(spectra.gains(joint, grid), grid, strict=True))
        others += [gain for gain, pair in pairs if pair[1] not in RATIOS]
        gain, pair = max(p for p in pairs if p[1][1] in RATIOS)
        best.append((gain, joint, pair))
    best.sort(reverse=True)
    gain, joint, (hertz, ratio) = best[0]
    others += [g for g, _, _ in best[1:2]]
    # Joint, frequency, damping and size were searched for.
    price = 2 * math.log(spectra.n / alpha) + 3 * math.log(float(spectra.count.sum()))
    if gain - max(others) < price or not low < hertz < high:
        return None
    # Ever finer around it; the curvature is what the spectra tell of the frequency.
    step = math.log(high / low) / (count - 1)
    for _ in range(4):
        step /= 3
        around = [
            (hertz * math.exp(k * step), ratio * factor)
            for k, factor in itertools.product((-2, -1, 0, 1, 2), (0.75, 1.0, 1.33))
        ]
        gains = spectra.gains(joint, around)
        hertz, ratio = around[int(np.argmax(gains))]
    down, top, up = spectra.gains(joint, [(hertz * math.exp(k * step), ratio) for k in (-1, 0, 1)])
    bend = max(2 * top - down - up, 1e-9) / step**2
    return joint, (hertz, ratio), 2 * math.sqrt(2 / bend)


class _Spectra:
    """What a model leaves on each joint, as spectra, and what swings would leave.

    Attributes:
        samples: whose filter and cut-off are the fit's.
        top: highest frequency [Hz].
        count: (O,) independent numbers in each octave.
    """

    def __init__(self, columns: Columns, keep: Bool[Tensor, "n N"]):
        self.samples, self.robot, self.n = columns.samples, columns.model.robot, columns.n
        every = self.samples.segments
        # 0.8: edge of what is compared, as a share of the segments' band
        self.top = 0.8 * every[0].band
        # The first instants, in whole segments but for a long one; and their samples.
        ends = list(itertools.accumulate(s.length for s in every))
        some = max(1, sum(1 for end in ends if end <= LONGEST))
        segments, first = every[:some], slice(0, LONGEST)
        self.motions = [m.part(first) for m in columns.motions[:some]]
        self.tau = [s.tau[first] for s in segments]
        step, edge = self.samples.step, self.samples.edge
        counts = [len(range(edge, len(tau) - edge, step)) for tau in self.tau]
        bounds = self.samples.bounds[:some]
        keep = torch.cat([keep[:, b][:, :c] for b, c in zip(bounds, counts, strict=True)], 1)
        # Octaves from half a hertz on; what is left below the top belongs to the last one where it
        # is less than half an octave. Above the fit's band are those of which more than half is.
        middles = [0.5 * 2 ** (k + 0.5) for k in range(12)]
        edges = [f / math.sqrt(2) for f in middles if f < self.top]
        self.above = torch.tensor([f >= self.samples.cutoff for f in middles[: len(edges)]])
        bins = [np.fft.rfftfreq(len(tau), 1 / self.samples.rate) for tau in self.tau]
        self.octaves = [
            torch.from_numpy(np.digitize(f[f < self.top], edges) - 1).clamp(min=-1) for f in bins
        ]
        # Two numbers a bin; the window takes a third of them for its own.
        numbers = torch.cat(self.octaves)
        self.count = torch.bincount(numbers[numbers >= 0], minlength=len(edges)) * (2 / 1.5)
        self.usable = bool(self.above.any()) and bool((self.count > 0).all())
        gaps = [s.tau[first] - columns.model.torque(s, self.samples)[first] for s in segments]
        chunks = [list(regressor_chunks(self.robot, *m.state)) for m in self.motions]
        self.rigid = [rigid_torque(self.robot, *m.state) for m in self.motions if self.usable]
        self.joints = []
        for i in range(self.n if self.usable else 0):
            moved = self.robot.moved_by(i)
            pairs = [(link, k) for link in moved for k in range(PARAMETERS_PER_LINK)]
            laws = [
                torch.cat(
                    [
                        torch.cat([c.row(i, pairs) for c in own], -1),
                        torch.stack([m.sign[:, i], m.dq[:, i], torch.ones_like(m.dq[:, i])]),
                    ]
                )
                for own, m in zip(chunks, self.motions, strict=True)
            ]
            self.joints.append(_Joint(self, i, laws, [g[:, i] for g in gaps], keep[i]))

    def of(self, signals: Signals) -> list[Tensor]:
        """Spectra (B, F) of signals of every segment, up to the top."""
        out = []
        for x, octave in zip(signals, self.octaves, strict=True):
            window = torch.hann_window(x.shape[-1], periodic=False, dtype=torch.float64)
            out.append(torch.fft.rfft(x * window)[..., : len(octave)] / window.norm())
        return out

    def power(self, spectra: Sequence[Tensor]) -> Float[Tensor, "B O"]:
        """Squares in each octave."""
        total = torch.zeros(spectra[0].shape[0], len(self.count), dtype=torch.float64)
        for x, octave in zip(spectra, self.octaves, strict=True):
            inside = octave >= 0
            total.index_add_(1, octave[inside], x[:, inside].abs().square())
        return total

    def gear(self, joint: int, pairs: Sequence[Pair]) -> Gear:
        """Gears of these resonances and dampings."""
        inertia = float(torch.cat([m[:, joint] for _, m in self.joints[joint].driven]).mean())
        hertz, ratio = zip(*pairs, strict=True)
        return Gear.ringing(max(inertia, 1e-12), hertz, ratio)

    def torques(self, joint: int, pairs: Sequence[Pair]) -> list[list[Tensor]]:
        """What swings of a joint do to the spectra of every joint, freed from the laws there."""
        gear = self.gear(joint, pairs)
        times = [m.require("t", "a swing") for m in self.motions]
        lags = [
            (column, link_lag(load[:, None], column[:, joint, None], t, gear))
            for (load, column), t in zip(self.joints[joint].driven, times, strict=True)
        ]
        return [
            j.freed([-(column[:, i] * lag.acceleration.T) for column, lag in lags])
            for i, j in enumerate(self.joints)
        ]

    def gains(self, joint: int, pairs: Sequence[Pair]) -> list[float]:
        """Twice the rise of the log likelihood by each swing, on all joints."""
        found = zip(self.joints, self.torques(joint, pairs), strict=True)
        return torch.stack([j.gain(x) for j, x in found]).sum(0).tolist()

    def late(self) -> list[float]:
        """Gains of torques that are late, each joint's for itself, or all alike."""
        gains = torch.stack([j.gain(j.late) for j in self.joints])
        return [*gains.flatten().tolist(), *gains.sum(0).tolist()]

    def taken_out(self, joint: int, pair: Pair, std: float) -> Swing:
        """A swing in numbers, `std` being the relative one of its compliance; from now on, what
        every joint leaves is what the swing leaves."""
        gear = self.gear(joint, [pair])
        compliance = 1 / float(gear.stiffness[0])
        # On the joint where it explains most above the fit's band.
        most = (0.0, 0.0)
        for j, x in zip(self.joints, self.torques(joint, [pair]), strict=True):
            before = j.squares
            j.leave([a - b for a, b in zip(j.left, x, strict=True)])
            was, now, whole = (float(p[0, self.above].sum()) for p in (before, j.squares, j.torque))
            if 0 < now < was and whole > 0:
                most = max(most, (1 - math.sqrt(now / was), math.sqrt((was - now) / whole)))
        # 0.1: relative error of the inertia that swings, and so of the compliance: a resonance is
        # the product of both
        std = compliance * math.hypot(std, 0.1)
        return Swing(compliance, std, float(gear.damping[0]), pair[0], *most)


class _Joint:
    """What a model leaves on one joint, as spectra, and laws that may explain a part of it: the
    rigid body's, dry and viscous friction, an offset. They are fitted in the fit's band."""

    def __init__(
        self,
        spectra: _Spectra,
        joint: int,
        laws: Signals,
        gap: list[Float[Tensor, " _"]],
        keep: Bool[Tensor, " N"],
    ):
        self.spectra, self.keep = spectra, keep.double()
        # Normal equations of the laws in the fit's band, in units of their columns.
        rows = spectra.samples.of(laws) * self.keep
        self.scale = rows.norm(dim=1).clamp(min=1e-12)
        self.rows = rows / self.scale.unsqueeze(1)
        ridge = 1e-6 * torch.eye(len(rows), dtype=torch.float64)
        self.root = torch.linalg.cholesky(self.rows @ self.rows.T + ridge)
        # What model and laws predict, and the laws, as far as they are signal.
        x = self.fit([g.unsqueeze(0) for g in gap])[0]
        tau = [x[:, joint] for x in spectra.tau]
        predicted = [t - g + x @ law for t, g, law in zip(tau, gap, laws, strict=True)]
        rate = spectra.samples.rate
        smooth = wiener(predicted, rate, spectra.top)
        self.laws = spectra.of([smooth(law) for law in laws])
        rest = [(t - smooth(p)).unsqueeze(0) for t, p in zip(tau, predicted, strict=True)]
        self.leave(spectra.of(rest))
        self.torque = spectra.power(spectra.of([t.unsqueeze(0) for t in tau]))
        # What drives the link: the load that is signal, and the joint's column of M(q).
        pairs = zip(spectra.motions, spectra.rigid, strict=True)
        driven = [joint_load(spectra.robot, m.state, joint, x) for m, x in pairs]
        smooth = wiener([load for load, _ in driven], rate, spectra.top)
        self.driven = [(smooth(load), column) for load, column in driven]

    def fit(self, signals: Signals) -> Float[Tensor, "B K"]:
        """Coefficients of the laws that are nearest to signals in the fit's band."""
        y = self.spectra.samples.of(signals) * self.keep
        return (torch.cholesky_solve(self.rows @ y.T, self.root) / self.scale.unsqueeze(1)).T

    def freed(self, signals: Signals) -> list[Tensor]:
        """Spectra of signals, without what the laws hold of them."""
        x = self.fit(signals).to(torch.complex128)
        pairs = zip(self.spectra.of(signals), self.laws, strict=True)
        return [spectrum - x @ law for spectrum, law in pairs]

    def leave(self, left: list[Tensor]) -> None:
        """Spectra (1, F) of what is left, and its squares (1, O) in each octave."""
        self.left, self.squares = left, self.spectra.power(left)

    def gain(self, torques: Sequence[Tensor]) -> Float[Tensor, " B"]:
        """Twice the rise of the log likelihood by each torque; rounding rises by nothing."""
        least = 1e-12 * self.torque + 1e-300
        after = self.spectra.power([a - b for a, b in zip(self.left, torques, strict=True)])
        rise = ((self.squares + least) / (after + least)).log()
        return (self.spectra.count * rise).sum(1)

    @cached_property
    def late(self) -> list[Tensor]:
        """Spectra of what the load would be less, were it delayed or filtered."""
        out, late = [], torch.tensor(LATE, dtype=torch.float64).unsqueeze(1)
        for (load, _), motion in zip(self.driven, self.spectra.motions, strict=True):
            t, rate, x = motion.require("t", "a delay"), self.spectra.samples.rate, load - load[0]
            size = fast_length(2 * len(x))
            turn = torch.arange(size // 2 + 1, dtype=torch.float64) * (2 * math.pi / size)
            # Low-passes of first order, and Butterworth's of second as far as a discrete one goes.
            keeps = (-1 / (rate * late)).exp()
            first = (1 - keeps) / (1 - keeps * torch.polar(torch.ones_like(turn), -turn))
            hertz = (1 / (2 * math.pi * late)).clamp(max=0.4 * rate)
            s = 1j * (turn / 2).tan() / (math.pi * hertz / rate).tan()
            second = 1 / (1 + math.sqrt(2) * s + s * s)
            spectrum = torch.fft.rfft(x, n=size) * torch.cat([first, second])
            filtered = torch.fft.irfft(spectrum, n=size)[:, : len(x)] - x
            delayed = [shifted(load.unsqueeze(1), t, -by)[:, 0] - load for by in LATE]
            out.append(torch.cat([torch.stack(delayed), filtered]))
        return self.freed(out)


def wiener(
    signals: Sequence[Float[Tensor, " _"]], rate: float, top: float
) -> Callable[[Float[Tensor, "*batch T"]], Float[Tensor, "*batch T"]]:
    """The filter that leaves of a signal (..., T) as much as is signal, at every frequency.

    The signals differentiate positions twice, so that white noise of these has a spectrum of f^4:
    it is what they end with.

    Args:
        signals: (T,) of every segment, from which the shares are taken.
        rate: of them [Hz].
        top: frequency [Hz] below which they are looked at.
    """
    width = min(round(2 * rate), *(len(x) for x in signals))
    parts = [density(x.unsqueeze(1).numpy(), rate, width) for x in signals]
    frequency = parts[0][0]
    lengths = np.array([len(x) for x in signals])
    power = np.average([p[:, 0] for _, p in parts], axis=0, weights=lengths)
    # 0.6: share of that from which the model's torque is taken to be noise of the positions
    end = (frequency > 0.6 * top) & (frequency < top)
    level = np.median(power[end] / frequency[end] ** 4)
    share = np.clip(1 - level * frequency**4 / np.maximum(power, 1e-300), 0, 1)
    share = np.convolve(np.pad(share, 2, mode="edge"), np.full(5, 0.2), "valid")

    def smooth(x: Float[Tensor, "*batch T"]) -> Float[Tensor, "*batch T"]:
        total = x.shape[-1]
        # Extended on both sides, to a length that the FFT likes.
        more = min(3 * total - 2, fast_length(5 * total // 2)) - total
        before = more // 2
        long = extended(x.reshape(-1, total), before, more - before)
        bins = np.fft.rfftfreq(long.shape[-1], 1 / rate)
        gain = torch.from_numpy(np.interp(bins, frequency, share))
        kept = torch.fft.irfft(torch.fft.rfft(long) * gain, n=long.shape[-1])
        return kept[:, before : before + total].reshape(x.shape)

    return smooth
