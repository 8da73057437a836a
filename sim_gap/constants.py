"""Every number of the verdict in one place.

Thresholds come from the project's page on the gap (winsorised gains, practical rule, constancy).
The confidence map is a first guess: looked at on single cases of the tuning set (nonces
0 and 3) and on drives made with `car_model`, not calibrated on a bank; report seeds never seen.
"""

WINSOR = 50.0
"""One window counts for no more than this many nats."""
GAIN_MIN = 10.0
"""Held-out gain below which nothing is a gap [nats]."""
GAIN_SE = 3.0
"""And in its standard errors."""
SHARE_MIN = 0.15
"""A gap in practice removes this share of the excess error ..."""
SPEED_MIN = 0.002
"""... or this much of the position error after a second [m]."""
AMBIGUOUS_SE = 2.5
AMBIGUOUS_NATS = 3.0
AMBIGUOUS_COS = 0.95
PAIR_SE = 3.0
PAIR_MIN = 12.0
"""A second cause gains at least this much on held-out drives [nats]."""
CONSTANT_SIGMA = 4.0
CONSTANT_SHARE = 0.35
"""Halves disagree when the values differ by this many sigmas and this share of the effect."""
EXPLAINED_MIN = 0.9
PARTIAL_MIN = 0.5
"""Shares of the excess that make a verdict `explained` or `partial`."""
EXCESS_LEFT = 1.25
"""Whitened error per degree of freedom that known noise leaves at most, sampling included."""
REFITS = 10
"""Candidates that are refitted after the screening."""
REFITS_ROUGH = 4
"""The same while noise is not known yet."""
CONFIDENCE_SLOPE = 0.8
CONFIDENCE_NATS = 4.0
"""A rival counts exp(-slope (best - gain) / (paired standard error + nats))."""
CONFIDENCE_MOST = 0.98
CONFIDENCE_PARTIAL = 0.6
"""No name is surer than this when part of the gap stays."""
CONFIDENCE_BROKEN = 0.5
"""Times this when halves disagree."""
GAIN_CLEAR = 40.0
"""A held-out gain that matters however small its millimetres are [nats]."""
