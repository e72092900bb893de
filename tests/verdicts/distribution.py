"""What the courses of this folder are drawn from: ranges, shares, and what counts as knowable.

This file was committed before a line of `analysis/` was changed for the corpus, and it does not change afterwards. A
judge that fails on these courses is changed, or its failure is stated; the distribution is not. Another distribution is
another file with its own name.

`courses.py` draws from here and decides the truth of a course from what was drawn, never from its samples.
"""

from typing import NamedTuple


class Range(NamedTuple):
    """An interval of a quantity, and whether its logarithm is what is uniform in it."""

    low: float
    high: float
    unit: str
    logarithmic: bool = False


class Share(NamedTuple):
    """How often a value is drawn among its alternatives, as a probability."""

    value: str
    probability: float


COURSES = 3000  # The seeds 0 to COURSES - 1 are the corpus: 0.1 % of a class of 1000 is then one course.

# --- the schedule of the session -------------------------------------------------------------------------------------

LEAD = Range(0.2, 1.0, "s")  # Before the hold the hand does not press, and the tip is in air.
HOLD = Range(0.5, 20.0, "s", logarithmic=True)  # From a student's short press to a long measurement of relaxation.
ARRIVAL = Range(0.0, 1.0, "of the hold")  # The tip arrives uniformly in the hold: surfaces are at unknown heights.
HAND_FORCE = Range(0.3, 5.0, "N", logarithmic=True)  # From a light touch to the most that a desktop device gives.
HAND_RAMP = Range(0.0, 0.2, "s")  # The hand takes this long from one force to the next.
RELEASE = Range(0.3, 1.0, "s")  # How long the recording goes on after the hand has let go.
RELEASED_SHARE = 0.4  # Probability that the hand lets go within the recording; else it ends with the hold.
TWO_HOLDS_SHARE = 0.15  # Probability of an earlier hold; the tip arrives in that one, as in the paper's Fig. 12.
FIRST_HOLD = Range(0.5, 3.0, "s", logarithmic=True)  # Length of that earlier hold.
FIRST_FORCE = Range(0.3, 0.8, "of the hand force")  # Its force.
NEVER_ARRIVES_SHARE = 0.02  # Probability that the tip stays in air: there is no motion of a loop, hence no truth.
NOTHING_MOVES_SHARE = 0.01  # Probability that no sample differs from another, as with a dead sensor: no truth.
SAMPLE_RATES_HZ = (125.0, 200.0, 250.0, 500.0, 1000.0)  # Rates of instruments [Hz]; 40 Hz has 3 samples in a period.
ROUND_TRIP = Range(0.002, 0.5, "s", logarithmic=True)  # From a laboratory's network to a satellite.
NO_DELAY_SHARE = 0.25  # Probability of a round trip of zero instead.

# --- what the law rests at -------------------------------------------------------------------------------------------

FORCE_GAIN = Range(0.5, 100.0, "", logarithmic=True)  # K_f: a loop rests at F_h / (1 + 1/K_f), for every K_f.
REST_STATED_SHARE = 0.7  # Probability that the law states its rest force; some laws have none.
REST_OFFSET = Range(-0.03, 0.03, "of the hand force")  # Calibration: the loop rests this much beside what is stated.

# --- the motion of the loop ------------------------------------------------------------------------------------------

# What the slowest or the growing mode does. Saturating growth becomes a cycle by leaving the surface.
MOTIONS = (
    Share("decays", 0.56),
    Share("grows", 0.22),
    Share("sustained", 0.10),
    Share("bounces", 0.07),
    Share("saturates", 0.05),
)
RATE = Range(0.05, 30.0, "1/s", logarithmic=True)  # |real part| of the pole; both signs.
FREQUENCY = Range(0.3, 40.0, "Hz", logarithmic=True)  # Imaginary part of the pole over 2 pi.
REAL_POLE_SHARE = 0.25  # Probability that a decaying or growing mode is real: slow approach, or running away.
MODE_COUNTS = (Share("1", 0.5), Share("2", 0.3), Share("3", 0.2))  # How many modes are summed.
OTHER_RATE = Range(1.5, 10.0, "times the rate", logarithmic=True)  # The other modes all decay, this much faster.
OTHER_RATE_SUSTAINED = Range(0.5, 30.0, "1/s", logarithmic=True)  # ... or at this rate, beside a rate of zero.
OTHER_AMPLITUDE = Range(0.2, 1.5, "of the main amplitude", logarithmic=True)  # Amplitude of another mode at first.
OTHER_IS_NEAR_SHARE = 0.2  # Probability that another mode beats with the main one.
NEAR_FREQUENCY = Range(0.8, 1.25, "of the main frequency", logarithmic=True)  # Where such a mode is.
DECAY_AMPLITUDE = Range(0.05, 1.5, "of the rest force", logarithmic=True)  # At arrival; above 1 the tip lifts off.
APPROACH_AMPLITUDE = Range(0.3, 1.0, "of the rest force")  # A real decaying mode starts this far off its rest.
APPROACH_FROM_BELOW_SHARE = 0.8  # Probability that it starts below it, as a tip that has just arrived does.
GROWTH_AMPLITUDE = Range(0.05, 0.5, "of the rest force", logarithmic=True)  # A growing mode at arrival ...
SOFT_GROWTH_AMPLITUDE = Range(0.003, 0.05, "of the rest force", logarithmic=True)  # ... or after a soft arrival.
SOFT_GROWTH_SHARE = 0.3  # Probability of that.
REAL_GROWTH_UP_SHARE = 0.8  # Probability that a real growing mode presses more and not less.
CYCLE_AMPLITUDE = Range(0.05, 0.95, "of the rest force", logarithmic=True)  # A cycle that stays in contact.
SATURATED_AMPLITUDE = Range(1.02, 1.6, "of the rest force")  # A growth that lifting off the surface bounds.
CONTACT_FRACTION = Range(0.3, 0.7, "of a period")  # How long a bouncing tip touches in each period.
ADHESION = Range(0.0, 0.2, "of the rest force")  # A pull that keeps the tip in contact below zero force.
GUARD_LIMIT = Range(6.0, 10.0, "times the hand force")  # The instrument withdraws above this force.
WITHDRAWAL_S = 0.03  # How long the force takes to vanish in a withdrawal [s], a stage at full speed.

# --- the arrival -----------------------------------------------------------------------------------------------------

SNAP_IN_SHARE = 0.5  # Probability of an attractive dip just before contact.
SNAP_IN_DEPTH = Range(0.02, 0.3, "of the rest force")  # How deep that dip is.
SNAP_IN_LENGTH = Range(0.004, 0.03, "s")  # How long it lasts.
BLOW_SHARE = 0.08  # Probability, for a decaying motion, that the tip strikes first and then comes to rest.
BLOW_PEAK = Range(2.1, 5.0, "times the hand force", logarithmic=True)  # Peak of the blow, above twice the hand force.
BLOW_LENGTH = Range(0.005, 0.04, "s", logarithmic=True)  # How long the tip touches in the blow.
BLOW_FLIGHT = Range(0.01, 0.08, "s", logarithmic=True)  # How long the tip is in air after the first blow.
BLOW_RESTITUTION = Range(0.3, 0.7, "")  # What peak and flight are multiplied by from one blow to the next.
BLOW_COUNTS = (Share("1", 0.5), Share("2", 0.25), Share("4", 0.25))  # How often it strikes.

# --- what disturbs the loop or opens it ------------------------------------------------------------------------------

OUTAGE_SHARE = 0.15  # Probability of outages of the link after the arrival.
OUTAGE_COUNTS = (Share("1", 0.7), Share("2", 0.2), Share("3", 0.1))  # How many.
OUTAGE_LENGTH = Range(0.02, 1.0, "s", logarithmic=True)  # Length of one; its place is uniform after the arrival.
COMMAND_DEADLINE_S = 0.05  # Without a command for this long the base stands [s], the instrument's default.
HOLD_BEFORE_WITHDRAWAL_S = 0.2  # Standing for this long the instrument withdraws [s], its default.
STARVED_SHARE = 0.5  # Probability that the base keeps its last rate up to the deadline; else the force is held.
STARVED_RATE = Range(0.5, 12.0, "hand forces/s", logarithmic=True)  # How fast the force changes then, either sign.
STALL_SHARE = 0.08  # Probability that a machine stalls after the arrival, for once.
STALL_LENGTH = Range(0.02, 0.2, "s", logarithmic=True)  # Length of the stall.
STALL_WITHOUT_SAMPLES_SHARE = 0.5  # Probability that no sample is recorded in it: the instrument's machine stalled.
OVERLOAD_SHARE = 0.05  # Probability that a machine is late again and again in the whole session.
OVERLOAD_COUNT = Range(10.0, 80.0, "overruns", logarithmic=True)  # How often.
OVERLOAD_KICK = Range(0.005, 0.06, "of the rest force", logarithmic=True)  # What one overrun excites the loop by.
PAUSE_SHARE = 0.03  # Probability that the operator pauses after the arrival: the base stands as commanded.
PAUSE_LENGTH = Range(0.2, 2.0, "s", logarithmic=True)  # Length of the pause.
RESTART_KICK = Range(0.05, 0.5, "of the rest force", logarithmic=True)  # What closing the loop again excites it by.
RANDOM_LINK_SHARE = 0.2  # Probability of jitter or loss, which excites the modes by chance all the time.
RANDOM_EXCITATION = Range(0.0, 0.03, "of the hand force")  # RMS of the motion that this excites.
STAMP_JITTER = Range(0.0, 0.2, "of a sample period")  # Sample times under jitter are off by at most this.
FRICTION_SHARE = 0.08  # Probability, for one decaying mode, of Coulomb friction. Growth against friction has a
# threshold of amplitude, so that its pole no longer states its fate: it is not drawn.
FRICTION = Range(0.05, 0.5, "of the first amplitude per 1/rate", logarithmic=True)  # Loss that does not shrink with it.
FRICTION_OFFSET = Range(-0.05, 0.05, "of the rest force")  # Where friction leaves the tip, beside its rest.
DRIFT_SHARE = 0.12  # Probability that the rest force is a slow ramp.
DRIFT = Range(-0.1, 0.1, "of the hand force over the hold")  # Its whole change, from thermal drift.
TREMOR_SHARE = 0.12  # Probability of a person's hand instead of a constant force.
TREMOR_FREQUENCY = Range(8.0, 12.0, "Hz")  # Physiological tremor of a hand.
TREMOR = Range(0.005, 0.06, "of the hand force", logarithmic=True)  # RMS of the tremor.
TREMOR_BAND_S = 0.5  # Amplitude and phase of the tremor change within this time [s]: a band of about 2 Hz.
WANDER = Range(0.005, 0.03, "of the hand force", logarithmic=True)  # RMS of the 1/f wander of a hand.
TREMOR_GAIN = Range(0.5, 1.2, "")  # How much of the hand's trembling the tip force follows.
NOISE_KINDS = (Share("none", 0.15), Share("white", 0.4), Share("pink", 0.25), Share("quantised", 0.2))  # pink: 1/f.
NOISE = Range(0.0, 0.08, "of the hand force")  # RMS of white and of 1/f noise; the step of a quantised force.

# --- what is honestly knowable ---------------------------------------------------------------------------------------
#
# `length` is the longest stretch after the first arrival in which the planned force was constant, the loop was closed
# and nothing that the recording states (interruption, overrun, blow) disturbed it. A course of which these rules say
# that there is no truth is in the corpus all the same, and is counted apart, with the rule's name as a tag.

LEAST_RATE_TIMES_LENGTH = 0.3  # Below, |rate| x length: decay, growth and a cycle look alike ("no_truth:short").
LEAST_PERIODS = 2.0  # Below, frequency x length: an envelope is not seen in less ("no_truth:few_periods"), ...
ENOUGH_RATE_TIMES_LENGTH = 3.0  # ... unless the amplitude changes by e^3 within, which shows without any period.
LEAST_REAL_GROWTH = 1.5  # Below, rate x length of a real growth: the slow ramp of a drift ("no_truth:like_a_drift").
VISIBLE_OVER_NOISE = 2.0  # A cycle or growth has at its end this amplitude over the RMS of all that is random, and ...
VISIBLE_OVER_FORCE = 0.03  # ... this amplitude over the hand force; else there is no truth ("no_truth:below_noise").
MAIN_OVER_OTHERS = 2.0  # A growth has at its end this amplitude over all other modes ("no_truth:others_larger").
SATURATED_PART = 0.5  # Part of the length in which a bounded growth is a cycle; else "no_truth:turning".
SATURATION_BEGINS = 0.5  # Below this part of its last amplitude a bounded growth is a growth as any other.
SATURATED_WITHIN = 0.02  # A bounded growth counts as a cycle this close to its last amplitude, as a ratio.

# --- the grid of cells -----------------------------------------------------------------------------------------------

RATE_CLASSES_PER_S = (0.05, 0.5, 4.0, 30.0)  # Bounds of |rate| [1/s]: slow, middle, fast; and none for a cycle.
FREQUENCY_CLASSES_HZ = (0.3, 1.5, 8.0, 40.0)  # Bounds of the frequency [Hz]: low, middle, high; and real for zero.
LENGTH_CLASSES_S = (0.0, 1.0, 4.0, 20.0)  # Bounds of the length [s]: short, middle, long.
LEAST_IN_A_CELL = 10  # Cells with fewer courses are one cell together, so that no course is outside of the limits.

# --- what a judge is measured by -------------------------------------------------------------------------------------

MOST_FALSE_ALARMS = 0.003  # Share of settling courses that are called a cycle or a growth.
MOST_MISSED_GROWTH = 0.001  # Share of growing courses that are called stable.
MOST_CANNOT_SAY = 0.08  # Share of all courses with a truth of which the judge cannot say what they do.
MOST_CANNOT_SAY_IN_A_CELL = 0.3  # ... and the same in any cell of the grid.
