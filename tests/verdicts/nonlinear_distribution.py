"""What the courses of `nonlinear.py` are drawn from: loops whose motion is no sum of exponentials.

An amplifier, a stage, a clamp and a hand bound a motion, keep it up, or let it come again. `distribution.py` has the
session around it (holds, hands, noise), and the rules by which a truth can be known; here is what the motion does.

This file was committed before the judge was changed for it, and it does not change afterwards.
"""

from distribution import Range, Share

# What happens in a course. Each has its own draw of whether the motion stays, grows until the end, or dies out.
MOTIONS = (
    Share("saturates", 0.14),
    Share("clamped", 0.10),
    Share("beats", 0.10),
    Share("wanders", 0.10),
    Share("delay_step", 0.14),
    Share("stick_slip", 0.08),
    Share("drifts", 0.10),
    Share("one_dies", 0.10),
    Share("rests", 0.14),
)
DIES_SHARE = 0.35  # Probability that beats, a wandering amplitude, a stick-slip or all of two swings die out.

# --- the motion ------------------------------------------------------------------------------------------------------

FREQUENCY = Range(0.4, 45.0, "Hz", logarithmic=True)
LAST_AMPLITUDE = Range(0.02, 5.0, "of the hand force", logarithmic=True)  # Of a swing that stays, at its end.
FIRST_AMPLITUDE = Range(0.001, 0.9, "of the last amplitude", logarithmic=True)  # Of one that grows to it.
GROWN_AT = Range(0.03, 1.2, "of the hold", logarithmic=True)  # When the growth alone would have come to that.
CLAMPED_SIDES = (Share("both", 0.4), Share("upper", 0.4), Share("lower", 0.2))  # Which side of the motion is cut off.
OVER_THE_CLAMP = Range(1.0, 1.6, "of the amplitude at the clamp")  # A real limit stops the growth of what it cuts.
DEPTH = Range(0.1, 1.0, "of the larger swing", logarithmic=True)  # How large the second swing of a beat is.
BEATS = Range(0.7, 25.0, "beats in the hold", logarithmic=True)
WANDER = Range(0.05, 0.5, "1, standard deviation of the logarithm of the amplitude")
WANDER_MEMORY = Range(0.005, 0.3, "of the hold", logarithmic=True)
LEAST_WANDERED = 0.25  # The amplitude of a wandering swing does not fall below this part of its middle value ...
MOST_WANDERED = 3.0  # ... and does not exceed this multiple of it.
PHASE_WANDER = Range(0.0, 0.8, "rad, standard deviation in a period")
STEP_AT = Range(0.1, 0.8, "of the hold")  # When the delay steps.
RATE_TIMES_REST = Range(0.3, 30.0, "1, logarithm", logarithmic=True)  # |rate| x what is left of the hold.
FREQUENCY_STEP = Range(0.6, 1.5, "of the frequency before", logarithmic=True)
STEP_FATES = (Share("dies", 0.4), Share("grows", 0.3), Share("stays", 0.3))  # What the motion does after the step.
SLIP_PART = Range(0.01, 0.35, "of a period", logarithmic=True)  # How long a slip takes.
SLIP_JITTER = Range(0.0, 0.3, "of a period")  # By how much two periods differ.
SLIP_RINGING = Range(0.0, 0.4, "of the slip")  # What rings after a slip ...
SLIP_RINGING_TURNS = Range(3.0, 12.0, "turns in a period")  # ... and how fast; it decays within a third of the period.
STOPS_AT = Range(0.1, 0.7, "of the hold")  # When a stick-slip ends that does.
STOPPED_WITHIN = 0.1  # Of a period: the time in which what it stopped at is gone, to a part of 1/e.
AMPLITUDE_DRIFT = Range(0.2, 5.0, "of the amplitude, from the start to the end", logarithmic=True)
DRIFT_SHAPES = (Share("line", 0.4), Share("root", 0.3), Share("exponential", 0.3))
OTHER_AMPLITUDE = Range(0.2, 20.0, "of the swing that stays", logarithmic=True)  # Of the swing that dies.
OTHER_FREQUENCY = Range(0.2, 5.0, "of the swing that stays", logarithmic=True)
DEATH = Range(1.5, 60.0, "1, logarithm over the hold", logarithmic=True)
HARMONICS_SHARE = 0.4  # Probability that a swing is no sine.
HARMONIC = Range(0.03, 0.4, "of the swing")  # Its second or third harmonic.
LANDING_SHARE = 0.5  # Probability of a landing beside it, which dies out.
LANDING = Range(0.05, 1.5, "of the hand force", logarithmic=True)
LANDING_DEATH = Range(4.0, 100.0, "1, logarithm over the hold", logarithmic=True)
CREEP_SHARE = 0.3  # Probability that the rest creeps by the logarithm of the time.
CREEP = Range(-0.08, 0.08, "of the hand force over the hold")
SURFACE_SHARE = 0.6  # Probability that the surface does not pull: below no force the tip is in air.

# --- what can be known, besides the rules of `distribution.py` -------------------------------------------------------

LEAST_IRREGULAR = 0.1  # Of the hand force: a random link excites less than this amplitude ("no_truth:like_excitation").
IRREGULAR_TURNS = 4.0  # A motion whose turns differ is seen in no fewer ("no_truth:few_periods").
LEAST_BEATS = 2.0  # Fewer than this many beats are a growth or a decay ("no_truth:few_beats").
MOST_MEMORY = 1.0 / 12.0  # A memory of more than this of what is seen looks like a growth ("no_truth:slow_wander").
MOST_STEADY_CHANGE = 0.15  # An amplitude that drifts by less than this, as a logarithm, is that of a cycle ...
LEAST_SWING_OVER_OTHERS = (
    1.0  # ... and a swing that stays is no smaller than this part of what dies beside it at the end.
)
GROWN_PART = 0.35  # A bounded motion is a cycle in at least this part of the hold; else "no_truth:turning".
AT_REST = 0.05  # From peak to peak, of the hand force: less than this in the last quarter is a motion at rest.

# --- what a judge is measured by -------------------------------------------------------------------------------------

MOST_STABLE_ALTHOUGH_IT_SWINGS = 0.001  # Share of courses that swing or grow at their end which are called stable.
MOST_OPEN_OF_RESTS = 0.002  # Share of courses that are at rest at their end of which the judge cannot say it.
MOST_OPEN_OF_FOUR_TURNS = 0.08  # ... and of growths and cycles of four turns or more.
MANY_TURNS = 4.0
