"""The thresholds of the verdicts; with those of `telenano.analysis.holds`, docs/verdicts.md has them in one table."""

# share of the hand's greatest force [1]: a smaller motion, peak to peak, is rest, and a smaller force does not press
SMALL_SHARE = 0.05
# change of a motion over a stretch [1, logarithm]: half of the 0.3 below which growth cannot be told from decay
LEAST_CHANGE = 0.15
# the same for a motion without a swing [1]: a quarter of a slow swing, and a drift that bends, change by less
ONE_SIDED_CHANGE = 1.5
# number of standard errors of a growth [1]: chance exceeds them to one side once in 160 times
SURE_ERRORS = 2.5
# number of standard errors beyond which a motion is likely to fall [1]: chance exceeds them once in forty times
LIKELY_ERRORS = 2.0
# round trips for which a force has to be seen [1]: a loop answers a step of the hand for about two
WAY_TRIPS = 4.0
# number of turns in a hold [1]: with fewer the size of each part depends on its phase
FEW_TURNS = 5.0
# standard errors of the power of noise [1]: chance exceeds them once in a thousand octaves
MEASURED_ERRORS = 3.0
# ratio of the noise in contact to that of the free tip [1]: so much they differ from 4 Hz on
NOISE_AGREES = 1.5
# least number of turns, or of occurrences [1]: fewer may be chance
LEAST_TURNS = 2.0
# error of an instrument as a share of the hand's force [1]: drift in a hold, noise, two calibrations; also the greatest
# share of a hold that may lack samples
ERROR_SHARE = 0.1
# residual that modes may leave, as a share of the root mean square of the motion [1]: the wall of a contact leaves a
# tenth, and the error of the instrument as much
LEFT_SHARE = 2.0 * ERROR_SHARE
# share of the hand's force below which there are only rounding errors [1]
FLOOR_SHARE = 1e-7
