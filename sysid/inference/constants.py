"""Every number that decides, in one place.

Calibrated on the development list of `benchmarks/foreign_cars` (nonce 20261124: 72 cases of 12 cars
on three simulators); `GAP_ODDS` and `LOUDEST` on 135 opened cases (sets 21 and 22), before set 23
was drawn to judge them; `RULED_OUT` and `FURTHER_ODDS` on sets 28 to 31. Tolerances stay in their
modules.
"""

GAP_ODDS = 5.0
"""Odds on a gap before a drive is seen: who asks why car and simulation differ has cause to."""
FURTHER_ODDS = 1000.0
"""Odds against each further cause, beside its share of the library."""
KNOWN_WIDER = 2.0
"""Prior standard deviations of a base on another day per those that its healthy drives left."""
WEAK = 2.0
"""Standard deviations of a prior that knows next to nothing per ordinary spreads of such cars."""
BUILT_IN = 3
"""Effects that a healthy car may turn out to have, beside those of every car."""
SIZE_SMALL = 0.05
"""A discrepancy that is smaller than any ordinary push (`DISCREPANCY` is 1)."""
GAP_SIZE = 0.3
"""A discrepancy beyond which something is left."""
HALF = 0.5
"""Share of the gap's size beyond which it counts as not explained."""
STRAINED = 6.0
"""Standard deviations of chi-square beyond which the base has moved further than it may."""
ALIKE_MOST = 0.75
"""No name is surer where another in the library differs by an equation's form alone."""
STANDS_IN = 0.03
"""A hypothesis this many times as likely as the best names what may be the cause instead."""
FAR = {1.0: 0.1, 3.0: 0.3}
"""Position errors after so many seconds [s: m] that no noise excuses, whatever its size was learnt
to be; healthy drives with pushes show up to 0.03 and 0.18."""
GROWN, GROWN_LEAST = 1.1, 0.002
"""Position errors that grow by this factor and this much [m] at any time are not explained."""
NOISE_KEPT = 0.97
"""What known noise leaves per degree of freedom of other drives than those it was learnt on."""
NOISE_SPREAD = 0.2
"""Standard deviation of what noise leaves of a block of windows, per what it should leave."""
DISCREPANCY, DISCREPANCY_MEMORY = (0.3, 0.3, 2.0), 0.3
"""A discrepancy of size 1: pushes along, across [m/s^2] and about the car [rad/s^2], and their
correlation time [s]: what a wrong model misses lasts as long as a manoeuvre's phase."""
SPUN, SPUN_SHARE = 12.0, 0.2
"""Squared error per degree of freedom from which a window counts as spun, and what more counts for:
its derivatives point nowhere, but where all are far off they still say how far."""
LOUDEST = 0.08
"""Share of the windows, those that speak loudest for a cause, that count no more than the next."""
REPEATS = 0.5
"""Share of the ordinary pushes that repeats from window to window (`c` of the design effect)."""
SHOWN_MOST = 3.0
"""What an effect gains by being as healthy drives show it is, per window, at most so many times its
gain in those: where a gap is large, any change along a gradient promises more."""
MODEL_ERROR, MODEL_ERROR_FORCES = 0.04, 0.12
"""Standard error that a wrong model adds per value or change, whichever is less; the second to a
force on the car. Without it 90 % intervals hold 75 % of 153 values of sets 21 to 23, with it 89."""
RULED_OUT = 12.5
"""Values that are less likely by so much (5 standard deviations) are none of this car's [nats]."""
CHANCE = 0.05
"""An effect that chance takes as far from its null this often is left out of the car file, where
the likelihood ratio does not reject the car without it at this level."""
COG_PLACE = 0.035
"""Doubt about where the centre of gravity is, per wheelbase: drives fix where the mocap body is
between the axles to a millimetre, but only the finer points of a model say where the centre of
gravity is. Root mean square of what 20 cars of four foreign simulators showed of a body that was
not misplaced; the largest was 24 mm on a car of 0.32 m."""
