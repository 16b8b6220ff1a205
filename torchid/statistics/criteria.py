"""The numbers that decide an answer, each with its unit and reason; all others are tolerances of an
algorithm and stand beside it. What a user may choose is in `GapSettings`."""

LIKELY = 0.5
"""Probability from which a cause is named [1]."""

EXPECTED = 0.3
"""Causes that are expected among all that are looked at [1]: with one, suspects that are said to be
70 % sure were right in a third of simulated cases and in half of real logs."""

UNLIKELY = 0.1
"""Probability of the least likely suspect that is listed [1]."""

SET_MASS = 0.9
"""Probability that the members of a set hold of all that may be there in a cause's place, and from
which a node of the tree of causes is a name [1]."""

WORTHWHILE = 0.05
"""Least share of a joint's error by which a cause must lower it to be worth a name [1]."""

WORTHWHILE_TORQUE = 0.01
"""The same as a share of the joint's torque [1]."""

DOUBT = 16 / 9
"""Odds against a cause, over the share of the squares that has no cause [1]: with a quarter of the
RMS left a cause is 90 % sure at most, with half of it 69 %."""

WRONG_FILE = 1 / 9
"""Odds beforehand that all parameters of a file are wrong, over those of another cause [1]."""

BODY_STD = 0.3
"""Standard deviation of the relative error of a model's inertial parameters [1]: CAD is known to
some ten per cent. Half of it asks for 1.2 times the evidence of an error of 30 %, double hardly
any."""

WRONG_BODY = 10.0
"""The same of a body that is plainly wrong, over that of a usual one [1]: errors of files have a
heavy tail (an inertia in another unit, one of two halves). It has the price of a shape, and so has
the scale of a torque that nobody doubts."""

MOVED_STD = 3.0
"""Standard deviations of what was known beyond which a coefficient has moved [1]."""

SAME_FACTOR = 2.0
"""Factor within which sizes are the same law [1]; friction laws vary by 1.02 to 1.04 between
motions that have them, effects that are not there by 1.3 to 1.6."""

TELLING_STD = 0.5
"""Standard deviation of a factor up to which a part can tell whether the effect is there [1]: two
of them from 0 to 1."""

ALIKE_LOSS = 1.5
"""Ratio of what two effects of a servo leave, in squares, below which neither is told from the
other [1]: no search over simulations ends nearer to its optimum on every start."""

MOST_MOTIONS = 0.7
"""Share of the motions that an effect of a servo matters to, from which it is no chance that they
are better with it [1]: of five motions four."""

SLIGHT_ERROR = 0.01
"""Share of the distance between command and position that calls for no cause [1]: a servo's own
cycle and its bus make as much."""

MOSTLY_EXPLAINED = 0.9
"""Share of a position gap, in squares, from which what is named is all of it [1]: a third of the
RMS is left then, which one more effect would be worth looking for."""

TORQUE_MISFIT = 1 / 3
"""Share of what servos leave of a joint's error that may be as a change of all its torques is
[1]: most of what is left is of other kinds, but nobody knows of which."""

UNSURE_SCALE = 0.2
"""Standard deviation of the scale of a joint's torques from which ratios alone are told [1]: a gain
to within half of it to either side is none to simulate with."""

SHEET_STD, UNIT_STD = 0.2, 0.05
"""Standard deviation of a maker's value, as a share of it, and the least between units of one type
[1]: the former holds supplies, wear and temperature; the latter tolerances of gears, magnets and
supplies."""

EXCESS = 1.35
"""Held-out variance of a joint, relative to its noise, from which something is unexplained where a
flexible predictor agrees [1]: noise is known to a few ten per cent."""

CLEAR_EXCESS = 2.0
"""The same from which it is, whatever a predictor says [1]."""

SMALL_ERROR = 0.03
"""Error of a joint, over its RMS torque while it moves, below which it is negligible without
repeats [1]: a careful fit leaves 3 % and more of the torque of most joints of real arms."""

LEAST_NOISES = 3.0
"""The same over the lower bound of its noise, up to which it may be noise [1]. The bound is the
spectrum above the fit's cut-off, continued as white: noise with a cut-off of 5 Hz is three times
that, of 1 Hz seven times, so alone it says nothing."""

SHORTEST_LOG = 8.0
"""Length of all samples below which `no gap` cannot be said [s]."""

BEYOND_ROBOT = 5.0
"""Times an arm's own moving mass, torque or reach, beyond which a size is none of its [1]."""

# What the doctor of logs decides by.

CLEAR_GAIN, TIED_GAIN = 0.4, 0.1
"""Falls of the sum of the joints' log errors, held out, from which a fault is found, and below
which two of them cannot be told apart [1]: .4 is as if one joint's error fell by a third. On
healthy logs, real ones and made ones with the friction of gears, no change was worth more than .15;
those that mend a planted fault mostly 1 to 15."""

AGREEING_BLOCKS = 0.85
"""Share of the blocks of time in which the error must fall, too [1]: seven of eight."""

EXPLAINED, TOLD, UNEXPLAINED = 0.2, 0.45, 0.6
"""Shares of a torque's spread that bodies leave [1]: up to the first in all joints, a fault that is
found is a doubt, and no positions are; up to the second, faults of that joint are told (what a
limit or a controller makes has no sign); from the third on (median of the joints) nothing about
this robot explains the torque."""

LEAST_GAIN = 1.5
"""Factor by which a joint's torque is off from which on it is a fault [1]: gears and drive gains
are off by less."""

OTHER_UNIT, ODD_SIZE, CAD_SIZE = 5.0, 2.2, 1.7
"""Factors between torque and nominal torque from which it is in another unit, odd, and within which
a unit's own factor is met [1]: CAD models err by up to the last."""

HOLDS_NONE, HOLDS = 0.3, 0.4
"""Shares of the nominal torque's parts (gravity, inertia) below which a torque holds none of one,
and from which it does [1]: masses of CAD models err by 40 %. A spring that carries an arm takes
more than the first of one joint's gravity, but not of every one's."""

LATE_TORQUE_S, LATE_VELOCITY_S = 0.008, 0.015
"""Lags behind the positions that are worth mending [s]: friction makes up for shorter ones."""

TILT_RAD = 0.0873
"""Tilt of gravity from which it is doubted [rad]: 5 degrees, what a floor, a flange and a model of
the friction make."""

BEYOND_LIMIT_RAD = 0.2
"""Angle beyond a limit from which a position is not the joint's [rad]: zeros are off by less."""
