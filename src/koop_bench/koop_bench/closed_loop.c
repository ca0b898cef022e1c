/* The offline closed loop in C, the yardstick of `koop bench offline`.
 *
 * The same operations in the same order as koop_loop.loop.run_kernel: measure, lift, project, detect,
 * relay, Runge-Kutta step.
 */
#include <math.h>

typedef struct {
    double epsilon0, epsilon0_drift, drift_frequency, forcing_amplitude, forcing_frequency, mu,
        x_offset, theta_star, a1, w1, p1, a2, w2, p2, dt;
} plant_t;

typedef struct {
    long lifted, p, n;
    const long *parent, *factor;
    const double *projector;
} lifting_t;

typedef struct {
    double alpha_hp, alpha_lp;
} detector_t;

typedef struct {
    double alpha, step_size, dwell_samples, widest_min, widest_max, theta_min, theta_max, sense;
} relay_t;

static double acceleration(const plant_t *q, double eps, double force, double x, double y,
                           double theta)
{
    double offset = x - q->x_offset, detuning = theta - q->theta_star;
    return -eps * (offset * offset - 1.0 - detuning * detuning) * y - q->mu * q->mu * offset + force;
}

static double damping(const plant_t *q, double t)
{
    return q->epsilon0 + q->epsilon0_drift * sin(q->drift_frequency * t);
}

static double forcing(const plant_t *q, double t)
{
    return q->forcing_amplitude * sin(q->forcing_frequency * t);
}

static void advance(const plant_t *q, long k, double *x, double *y, double theta)
{
    double h = q->dt, t = (double)k * h, half = 0.5 * h;
    double k1x = *y, k1y = acceleration(q, damping(q, t), forcing(q, t), *x, *y, theta);
    double eps = damping(q, t + half), force = forcing(q, t + half);
    double k2x = *y + half * k1y;
    double k2y = acceleration(q, eps, force, *x + half * k1x, k2x, theta);
    double k3x = *y + half * k2y;
    double k3y = acceleration(q, eps, force, *x + half * k2x, k3x, theta);
    double k4x = *y + h * k3y;
    double k4y = acceleration(q, damping(q, t + h), forcing(q, t + h), *x + h * k3x, k4x, theta);
    double sixth = h / 6.0;
    *x = *x + sixth * (k1x + 2.0 * k2x + 2.0 * k3x + k4x);
    *y = *y + sixth * (k1y + 2.0 * k2y + 2.0 * k3y + k4y);
}

static double energy(const lifting_t *l, const double *state, double *z)
{
    if (!l->lifted)
        return sqrt((state[0] * state[0] + state[1] * state[1]) / 2.0);
    z[0] = 1.0;
    for (long i = 1; i < l->p; i++)
        z[i] = z[l->parent[i]] * state[l->factor[i]];
    double total = 0.0;
    for (long j = 0; j < l->n; j++) {
        double c = 0.0;
        for (long i = 0; i < l->p; i++)
            c += l->projector[j * l->p + i] * z[i];
        total += c * c;
    }
    return total;
}

/* Fills the last four arrays, until y_out is not finite. */
void run(const plant_t *q, const lifting_t *l, const detector_t *d, const relay_t *e, double theta0,
         double x, double y, long steps, double *z, double *measured, double *truth, double *r_out,
         double *theta_out)
{
    double y_previous = 0.0, y_hp = 0.0, y_lp = 0.0, hp = 0.0, r_previous = 0.0, theta = theta0;
    double since_flip = 0.0;
    int epsilon = 1;
    for (long k = 0; k < steps; k++) {
        double t = (double)k * q->dt, r = 0.0, state[2];
        double i = q->a1 * sin(q->w1 * t + q->p1) + q->a2 * sin(q->w2 * t + q->p2);
        state[0] = x + i;
        state[1] = y + i;
        double y_out = energy(l, state, z);
        if (!isfinite(y_out))
            return;
        if (k > 0) {
            y_hp = d->alpha_hp * y_hp + (1.0 - d->alpha_hp) * (y_out - y_previous);
            y_lp = d->alpha_lp * y_lp + (1.0 - d->alpha_lp) * (y_hp * y_hp);
            r = y_lp > 0.0 ? y_lp : 0.0;
            hp = e->alpha * hp + (1.0 - e->alpha) * (e->sense * (r - r_previous));
            since_flip += 1.0;
            if (hp > 0.0 && since_flip >= e->dwell_samples) {
                epsilon = -epsilon;
                since_flip = 0.0;
            }
            theta -= e->step_size * epsilon;
            theta = theta < e->theta_min ? e->theta_min : theta;
            theta = theta > e->theta_max ? e->theta_max : theta;
        }
        y_previous = y_out;
        r_previous = r;
        measured[2 * k] = state[0];
        measured[2 * k + 1] = state[1];
        truth[2 * k] = x;
        truth[2 * k + 1] = y;
        r_out[k] = r;
        theta_out[k] = theta;
        advance(q, k, &x, &y, theta);
    }
}
