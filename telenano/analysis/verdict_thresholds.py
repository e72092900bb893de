"""The thresholds of the verdicts, each once with its reason; docs/verdicts.md has the table that is made from these."""

# share of the hand's greatest force [1]: what moves less from peak to peak is rest, and a smaller force does not press
SMALL_SHARE = 0.05
# change of a regular motion [1, logarithm]: half of 0.3, below which decay, growth and a cycle look alike
LEAST_CHANGE = 0.15
# the same of an irregular motion [1, logarithm]: chance changes its size by a quarter
IRREGULAR_CHANGE = 0.45
# the same without a swing [1, logarithm]: a quarter of a slow swing, and a drift that bends, change by less
ONE_SIDED_CHANGE = 1.5
# round trips that a way to one side has to be seen for [1]: a loop answers a step of the hand for about two
WAY_TRIPS = 4.0
# share of the hand's force, or of a hold [1]: what an instrument may err by: drift, calibration, lacking samples
ERROR_SHARE = 0.1
# share of a motion that a fit may leave [1]: the wall of a contact leaves as much
LEFT_SHARE = 0.04
# standard errors [1]: chance exceeds them to one side once in 160 times
SURE_ERRORS = 2.5
# standard errors [1]: chance makes a fall of that once in forty times, beside which nothing goes on
LIKELY_ERRORS = 2.0
# standard errors of the power of noise [1]: chance exceeds them once in a thousand octaves
MEASURED_ERRORS = 3.0
# ratio of the noise in contact to that of the free tip [1]: so much they differ from 4 Hz on
NOISE_AGREES = 1.5
# turns, or times [1]: what is seen less often may be chance
LEAST_TURNS = 2.0
# turns in a hold [1]: with fewer the size of each part depends on its phase, and modes are fitted
FEW_TURNS = 5.0
# parts of a hold whose sizes are compared [1]: each of an even number has half a turn of the slowest motion
PARTS = 10
# power of a line over that of noise [1]: white noise has such a line once in 5e8
LINE_OVER_NOISE = 20.0
# samples [1]: fewer do not tell a mode from the constant and the drift
LEAST_SAMPLES = 16
# share of the hand's force [1]: below there are only rounding errors
FLOOR_SHARE = 1e-7
# time before which the hand acted on the tip, beside the transit of the line [s]: laws filter the hand's force so long
HAND_LAG_S = 0.25

# shortest hold [s]: a slow loop swings at some 5 Hz
SHORTEST_HOLD_S = 0.5
# share of a hold that hand and tip have to be coupled for [1]: otherwise it is none of theirs
COUPLED_SHARE = 0.5
# share of the hand's greatest force that it may change by in a hold [1]: sensors of hands tell no less
STEADY_SHARE = 0.01
# forces of the hand with which the tip strikes, or to which its trembling adds [1]: an undamped spring meets a step so
STRUCK_FORCES = 2.0
# distance of hand and tip at rest, at the hand's scale [m]: three times the 0.33 mm by which 1 N moves the hand on a
# sample of 20 N/m
PARTED_M = 1e-3
# lateness that is laid to the machine or the link [s]: a fifth of the deadline of both devices
LATE_S = 0.01
