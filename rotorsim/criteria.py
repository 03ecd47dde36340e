"""Every number that decides a verdict, with where it is from; numerical tolerances stay where they are used."""

from __future__ import annotations

from dataclasses import dataclass
from math import log

Z90 = 1.6448536269514722  # half width of a central 90 % interval of a normal distribution, in standard deviations


@dataclass(frozen=True)
class Criteria:
    """Thresholds of identification and diagnosis. Probabilities are of a right model failing; ratios have no unit."""

    # -- adequacy of a fit ---------------------------------------------------------------------------------------------
    # probability of a misfit, below which a model does not explain the data: one wrong finding in 10 000 recordings
    not_explained: float = 1e-4
    # residual variance, of the noise's, that is not worth a name whatever its probability: a variance estimated from n
    # independent samples is wrong by sqrt(2 / n), 5 % for the 800 between the harmonics of a run of 0.2 s at 5 kHz
    model_error: float = 1.05
    # of the equations, in the misfit: what beams of another program differ by, whose meshes, matrices and integration
    # are others; three times the 100 of 2952 that were seen (tests/diagnosis/test_other_beams.py)
    mesh_error: float = 0.1
    # in the misfit: what a finer mesh changes, above which it is taken. What is left moves the parameters by one
    # standard deviation, times 16/15 for still finer ones, in the direction that shows most, and less in all others
    mesh_visible: float = 1.0
    # of the rms of all signals: residual of the harmonics of a run that has no settled motion
    settled: float = 0.5
    # of a disturbance over the window of a run: growth that a recording of a settled motion would show
    growth: float = 0.1

    # -- identification ------------------------------------------------------------------------------------------------
    # half width of the 90 % interval, as part of the value, from which on a parameter is not identified
    precision: float = 0.05
    # correlation above which a parameter is named as the partner of another
    correlated: float = 0.9
    # of the width of an interval: what remains when the partners are known, above which they are not the reason
    partners: float = 1 / 3
    # variance of the noise in a column of the regression, of its square, that pulls its parameter too far to zero
    attenuated: float = 0.25
    # of the largest residual that noise alone makes in all draws of the scatter of a regression
    scatter: float = 2.0
    # probability of a place from which it counts as located
    located: float = 0.9

    # -- forward selection ---------------------------------------------------------------------------------------------
    # probability that noise alone makes any fault candidate look as good, by Bonferroni; 200 healthy machines of
    # benchmarks/concealed/results/nuisances_1617.md keep it
    false_alarm: float = 0.01
    # criterion within which two hypotheses are not separated: odds of e^5 = 148 to 1, from which evidence counts as
    # very strong (Kass & Raftery, J. Am. Stat. Assoc. 90 (1995) 773-795, section 3.2)
    equivalent: float = 10.0
    most_effects: int = 3
    # share of the unexplained misfit that one more effect must explain: details of the first law are many and small,
    # so that none of them is most of the remainder
    worth: float = 0.9
    # share of the misfit that a cause must explain to be named: between laws that imitate others and right laws with
    # details, `python -m benchmarks.concealed shares` (docs/diagnosis.md)
    cause: float = 0.98
    # standard deviations below which a parameter of a law is tried without: it goes where the criterion falls
    significant: float = 2.0
    # times its size, as given and in the fit before: nobody states a value so wrong, and what cancels an effect is so
    astray: float = 100.0
    # times what is stated, and a tenth: where the diagram as given stays if it went astray. In decades half as far
    near_stated: float = 10.0
    # times the misfit astray, that may be left there: a few per cent more for want of a law, far more than twice if
    # what is stated is wrong (tests/diagnosis/evidence/waveform/test_astray.py)
    near_misfit: float = 2.0
    # physics that explain the data alike, beyond which nothing is named: a longer list is no name
    most_equivalent: int = 4
    # probability from which a place is listed
    listed: float = 0.01

    # -- validation on hold-out runs -----------------------------------------------------------------------------------
    # probability of the misfit of hold-out runs, below which noise does not make it: a right repair is disproved in
    # one case of a hundred, as often as a false alarm is raised
    surprise: float = 0.01
    # share of the unexplained misfit there that an otherwise exact law may leave: 1 % of the amplitude, what harmonics
    # of a law with corners are good to
    details: float = 1e-4
    # times the share left in fitted runs, that may be left in others, at other speeds and gains: three times the
    # amplitude, as for forces that grow with the square of a speed 1.7 times higher
    extrapolation: float = 10.0
    # of the fall of the misfit in fitted runs, or of the whole residual beyond noise where that is less, that must be
    # seen in hold-out runs: a true effect shows all of it there, what was fitted to noise nothing, or the reverse
    material: float = 0.5
    # of the misfit, by which a true effect may make it rise there: one of d standard deviations makes it fall by
    # d^2 +- 2 d; two deviations below that mean are least at d = 2, a rise by 4
    hidden: float = 4.0
    # residual variance, of the noise's, below which the model of the noise may be wrong; 200 healthy machines with hum,
    # flicker noise, drift, lost samples and sampled pulses leave up to 1.20 (benchmarks/concealed/results)
    faint: float = 1.5
    # residual variance, of the noise's, below which a force is not told from noise of some channels that is not as
    # modelled: the same 200 machines
    slight: float = 1.2
    # level of intervals of shares
    level: float = 0.9

    # -- forces and lines ----------------------------------------------------------------------------------------------
    # probability that noise alone makes any order of an unknown force or of a residual
    chance: float = 1e-3
    # of the largest harmonic of an unknown force: those above are stated
    stated: float = 0.1
    # of the misfit that one more term of the map of an unknown force must explain
    map_term: float = 0.1
    # probability of a false alarm of drift, for a channel of a recording
    drift: float = 1e-3
    # of the drift of 1X beyond noise that a law which grows within the runs must explain: most of it, since a bow need
    # not grow as one exponential does, while drifts of the speed, from run to run of any sign, are no growth at all
    cause_of_drift: float = 0.5
    # residual variance, of the noise's, above which a diagram does not say which offsets drift of themselves
    drift_judged: float = 2.0
    # of the power of a line: a force that explains it, by transfer functions that need not be quite right
    line_force: float = 0.9
    # twice the logarithm of the odds: mains hum is pick-up, unless a force is a thousand times more likely
    pickup_odds: float = 2 * log(1000.0)
    # standard deviations of the separation of two hypotheses from which a run that does not suffice is named
    separation: float = 1.0

    # -- samples in time -----------------------------------------------------------------------------------------------
    # times the rms residual of the flexible model, that counts as no worse: F-test of 60 and 60 samples at 5 %, 1.24
    no_worse: float = 1.25
    # of what the diagram leaves and the flexible model does not, that an adequate model may leave
    flexible_share: float = 0.01
    # of the scale of a signal: model errors below are not looked for
    resolution: float = 1e-3
    # of the rms of a signal: more remains of it by noise alone only where that is white
    noisy: float = 0.3
    # of the mean square of a residual, from which on it counts as white
    white: float = 0.5
    # residual variance, of that of the flexible model, below which a fit takes its place
    surpassed: float = 0.5
    # of a law that the samples must be able to tell from noise (chi-squared), or no verdict says that there is none:
    # two in each of five places
    law_parameters: int = 10
    # variance of what is not predictable, of its white part: hum and drift of 2 standard deviations and flicker noise
    # together (benchmarks/concealed, --nuisances all) make 1 + 2 + 4/3 + 1
    colour: float = 6.0

    # of what all stretches together may leave, beyond which it is no noise however it scatters: a log-normal level with
    # the median of noise leaves exp(s^2 / 2) = 3 where it changes fourfold from stretch to stretch (s = 1.5); pulses
    # that are late by parts of a sample leave 2.2 (at a resonance), edges of a rounding that are not quite sharp 2.7
    uneven: float = 3.0

    # -- resonances ----------------------------------------------------------------------------------------------------
    # relative error of a frequency: what a beam model from drawings is good for
    frequency: float = 0.03
    # sqrt(1 - MAC) of a shape: a MAC of 0.91
    shape: float = 0.3
    # velocity of a resonance that counts, of the largest
    resonance_level: float = 0.1
    # times the least misfit that is promised: fault candidates beyond are not tried at every place
    screened: float = 20.0


CRITERIA = Criteria()
