"""The thresholds of the verdicts; with those of `telenano.analysis.holds`, docs/verdicts.md has them in one table."""

# share of the hand's greatest force [1]: what moves less from peak to peak is rest, and a force below it presses not
SMALL_SHARE = 0.05
# change of a motion over a stretch [1, logarithm]: half of the 0.3 below which growth cannot be told from decay
LEAST_CHANGE = 0.15
# the same of a motion without a swing [1]: a quarter of a slow swing, and a drift that bends, change by less
ONE_SIDED_CHANGE = 1.5
# standard errors of a growth [1]: chance exceeds them to one side once in 160 times
SURE_ERRORS = 2.5
# standard errors [1] of a fall beside which nothing is said to go on: chance exceeds them once in forty times
LIKELY_ERRORS = 2.0
# turns [1], or times: what is seen less often may be chance
LEAST_TURNS = 2.0
# what an instrument may err by, as a share of the hand's force [1]: drift in a hold, noise, two calibrations, and as a
# share of a hold: samples that it lacks
ERROR_SHARE = 0.1
# what modes may leave of a motion, as a share of its root mean square [1]: the wall of a contact leaves a tenth, and
# the instrument errs by as much
LEFT_SHARE = 2.0 * ERROR_SHARE
# below this share of the hand's force [1] there are rounding errors
FLOOR_SHARE = 1e-7
