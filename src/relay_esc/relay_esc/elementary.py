"""Natural logarithm and exponential of sums, products and divisions only.

The C library's round differently from one processor or version to the next, in the last bit and
rarely; a replay on another machine has to be the same to the last bit.
"""

from __future__ import annotations

import math

from koop_core.kernels import njit

LN2_HIGH = 0.693147180369123816490  # the leading 32 bits of ln 2: times an exponent, exact
LN2_LOW = 1.90821492927058770002e-10
INVERSE_LN2 = 1.4426950408889634
LARGEST = 709.0  # exp of more is not a number of 64 bits


@njit()
def log(x: float) -> float:
    """Return ln x of a finite x > 0, to a few units in the last place.

    x = m 2^e with m around 1; ln m = 2 artanh s, s = (m - 1) / (m + 1), |s| < 0.172.
    """
    m, e = math.frexp(x)
    if m < 0.7071067811865476:
        m, e = 2.0 * m, e - 1
    s = (m - 1.0) / (m + 1.0)
    square = s * s
    series = 0.0
    for n in range(21, 1, -2):
        series = square * (series + 1.0 / n)
    return e * LN2_HIGH + (2.0 * (s + s * series) + e * LN2_LOW)


@njit()
def exp(x: float) -> float:
    """Return e^x to a few units in the last place; x is kept within +-709.

    x = k ln 2 + f with |f| < 0.35, then Taylor's series of f.
    """
    x = min(max(x, -LARGEST), LARGEST)
    k = math.floor(x * INVERSE_LN2 + 0.5)
    f = (x - k * LN2_HIGH) - k * LN2_LOW
    series = 1.0
    for n in range(14, 0, -1):
        series = 1.0 + f * series / n
    return math.ldexp(series, int(k))
