"""What the equations of absorber.c say."""

W, Z1, Z2, M = 6.283185307179586, 0.01, 0.03, 0.05


def amplitude(tuning):
    """Return the amplitude of the mass for a force of 1, once it has settled.

    By the complex amplitudes of a motion at w: nothing is integrated.
    """
    wa = tuning * W
    d = wa * wa + 2j * Z2 * wa * W
    return abs(1.0 / (2j * Z1 * W * W - M * d * W * W / (d - W * W)))
