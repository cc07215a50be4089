"""How the numbers were made, with the equations: short enough to read, exact enough to repeat."""

from __future__ import annotations

from ..report_blocks import Block, Equation, Section, Text
from ..report_view import PassView
from ._mathml import frac, ident, math, num, op, over, row, space, sqrt, sub, subsup, sup, under, word

FUSION = (
    "Measurement. All sensors of both bodies are fused in one filter and smoothed over the whole log: "
    "GNSS position moved from the antenna to the centre of mass with the machine's roll and pitch, "
    "gyros, accelerometers, wheel-mounted units, and the rigid hitch. Sensor biases, latency, slips and "
    "a slowly varying GNSS error are estimated with it. The stated standard deviations include the "
    "doubt in lever arms and mounting."
)
MODEL = (
    "Model. Two rigid bodies in the plane, joined at the hitch, by Lagrange's equations of the second "
    "kind; q holds the tractor's position and the two yaw angles. In replay the model is driven by the "
    "steering and the speed that were measured on this pass; it never sees the measured path, except "
    "for each window's start."
)
WINDOWS = (
    "Windows. The row is cut into windows of constant length (the horizon). In each the simulation "
    "starts from the smoothed state, and a lateral offset, a heading and a steering offset, θ, may move "
    "it, bound by their stated covariance P₀: steering that is 0.05° off for a few seconds would "
    "otherwise make a perfect model look wrong. Scale, distance, time and curvature never move. Should "
    "θ ask for more than χ² = 7.81, its prior is made heavier until it does not."
)
DISCREPANCY = (
    "Discrepancy. With e the simulated less the measured deviation on a grid of 0.2 m, M the mean of e² "
    "over the row's windows, and R95 the range between the 2.5 % and 97.5 % quantiles of the measured "
    "deviation, centred:"
)
AFTER_D = (
    "The same with yaw in place of deviation. Both bodies combine by their quadratic mean. R95 is on the "
    "scale of the paper's “range of oscillations”, but does not grow with the record's length. The paper "
    "gives 11 % (trajectories) and 9 % (turning angles) without formula, spread or alignment; they are "
    "shown for orientation. Where R95 is under four standard uncertainties, or under 2 cm (0.3°), no "
    "percentage is given."
)
VERDICT = (
    "Verdict. The upper bound D_hi must be under the threshold for every response to call the model "
    "adequate; the lower bound D_lo, with input uncertainty removed as well, must be above it to call the model "
    "not adequate. Both have measuring error removed and D has not, so a printed interval is widened "
    "to hold D. u is what the measurement's own error leaves in e after the alignment, g the guard factors "
    "(0.8 and 1.25 while the filter's own tests hold, else 0.5 and 2):"
)
NULL = (
    "Null model. A straight line, aligned in the same windows in the same way, is scored beside the "
    "model: within a window even a poor model reads low, so an adequate one must do clearly better than "
    "the line."
)

Q, QD, QDD = ident("q"), over(ident("q"), "˙"), over(ident("q"), "¨")
R95_SQUARED = subsup(ident("R"), num("95"), num("2"))
U_SQUARED = sup(ident("u"), num("2"))

LAGRANGE = Equation(
    math(
        ident("M"),
        op("("),
        Q,
        op(")"),
        QDD,
        op("+"),
        ident("h"),
        op("("),
        Q,
        op(","),
        QD,
        op(")"),
        op("="),
        ident("Q"),
        op("("),
        Q,
        op(","),
        QD,
        op(","),
        ident("γ"),
        op(")"),
    ),
    r"M(q)\,\ddot{q} + h(q, \dot{q}) = Q(q, \dot{q}, \gamma)",
    "mass matrix times acceleration plus quadratic velocity terms equals generalised forces, which "
    "depend on the steering angle gamma",
)
ALIGNMENT = Equation(
    math(
        ident("θ"),
        op("="),
        word("arg min"),
        op("("),
        under(op("∑"), word("grid")),
        sup(ident("r"), ident("T")),
        sup(ident("S"), num("−1")),
        ident("r"),
        op("+"),
        sup(ident("θ"), ident("T")),
        subsup(ident("P"), num("0"), num("−1")),
        ident("θ"),
        op(")"),
    ),
    r"\theta = \mathrm{arg\,min}\;(\sum_\mathrm{grid} r^{T} S^{-1} r + \theta^{T} P_0^{-1} \theta)",
    "theta minimises the sum over the grid of r transposed S inverse r, plus theta transposed P zero "
    "inverse theta",
)
HEADLINE = Equation(
    math(
        ident("D"),
        op("="),
        num("100"),
        op("%"),
        op("·"),
        frac(sqrt(ident("M")), sub(ident("R"), num("95"))),
        op(","),
        space(),
        ident("M"),
        op("="),
        over(sup(ident("e"), num("2")), "¯"),
        op(","),
        space(),
        sub(ident("R"), num("95")),
        op("="),
        sub(ident("Q"), num("97.5")),
        op("−"),
        sub(ident("Q"), num("2.5")),
    ),
    r"D = 100\,\%\cdot\dfrac{\sqrt{M}}{R_{95}}\,,\qquad M = \overline{e^2}\,,"
    r"\qquad R_{95} = Q_{97.5} - Q_{2.5}",
    "D is one hundred percent times the square root of M over R95, M the mean of e squared, R95 the "
    "97.5 percent quantile less the 2.5 percent quantile",
)
UPPER = Equation(
    math(
        subsup(ident("D"), word("hi"), num("2")),
        op("="),
        frac(
            row(
                sub(ident("M"), word("hi")),
                op("−"),
                word("min"),
                op("("),
                sub(ident("g"), word("lo")),
                U_SQUARED,
                op(","),
                sub(ident("M"), word("hi")),
                op("/"),
                num("2"),
                op(")"),
            ),
            row(
                word("max"),
                op("("),
                R95_SQUARED,
                op("−"),
                sup(num("3.92"), num("2")),
                sub(ident("g"), word("hi")),
                U_SQUARED,
                op(","),
                R95_SQUARED,
                op("/"),
                num("4"),
                op(")"),
            ),
        ),
    ),
    r"D_\mathrm{hi}^2 = \dfrac{M_\mathrm{hi} - \min(g_\mathrm{lo}\,u^2,\; M_\mathrm{hi}/2)}"
    r"{\max(R_{95}^2 - 3.92^2\,g_\mathrm{hi}\,u^2,\; R_{95}^2/4)}",
    "D high squared is M high less the lesser of g low u squared and half of M high, over the greater "
    "of R95 squared less 3.92 squared g high u squared and a quarter of R95 squared",
)
LOWER = Equation(
    math(
        subsup(ident("D"), word("lo"), num("2")),
        op("="),
        frac(
            row(
                word("max"),
                op("("),
                sub(ident("M"), word("lo")),
                op("−"),
                sub(ident("g"), word("hi")),
                op("("),
                U_SQUARED,
                op("+"),
                subsup(ident("u"), word("in"), num("2")),
                op(")"),
                op(","),
                num("0"),
                op(")"),
            ),
            R95_SQUARED,
        ),
    ),
    r"D_\mathrm{lo}^2 = \dfrac{\max(M_\mathrm{lo} - g_\mathrm{hi}(u^2 + u_\mathrm{in}^2),\; 0)}{R_{95}^2}",
    "D low squared is the greater of zero and M low less g high times the sum of u squared and u input "
    "squared, over R95 squared",
)

BLOCKS: tuple[Block, ...] = (
    Text(FUSION),
    Text(MODEL),
    LAGRANGE,
    Text(WINDOWS),
    ALIGNMENT,
    Text(DISCREPANCY),
    HEADLINE,
    Text(AFTER_D),
    Text(NULL),
    Text(VERDICT),
    UPPER,
    LOWER,
)


def build(view: PassView) -> Section:
    """The section; the same for every pass of this version."""
    return Section("methods", "How this was computed", BLOCKS)
