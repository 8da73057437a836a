/* The filter's inside: beliefs predicted and fused, chain by chain.
 *
 * The equations come printed (`car_model.prediction`). What stands here is the order of the steps:
 * which command holds when, how an interval is divided, which matrices are multiplied. Sums of
 * products run in a fixed order. `estimator/reference.py` is the same in Python.
 */
#include <math.h>

#define SECONDS 1e-9
#define NEVER_NS ((int64_t)1 << 62)
#define ABSURD 1e6 /* no reading of any instrument, in any SI unit, is this large */

enum {
    SIZE = car_STATES, SQUARE = SIZE * SIZE, BELIEF = SIZE + SQUARE, WIDEST = 3,
    DRIVEN = 6
};

/* An instrument: one reading of each state named, times the gain. */
typedef struct {
    double count, state[WIDEST], gain, variance[WIDEST], gate, yaw_row;
} sensor_t;

/* What does not change while a filter runs. */
typedef struct {
    const double *p, *q, *density; /* parameters, constants, (SIZE,) */
    const sensor_t *sensors;       /* by kind */
    int64_t steer_late, drive_late; /* [ns] */
} setup_t;

typedef struct {
    double x[SIZE], P[SQUARE];
} belief_t;

typedef struct {
    int64_t t, kind;
    double values[WIDEST];
} measurement_t;

/* What is asked, one array: how many commands and measurements, two instants; then the commands'
 * times, the commands, the belief at `start` and the measurements after it. */
typedef struct {
    int64_t known, count, start, stop;
} asked_t;

/* The commands of the recent past, in the order of their times. */
typedef struct {
    int64_t known;
    const int64_t *times;
    const double *commands; /* steer, speed; not a number where nothing was driven */
} past_t;

/* The parts of what is asked; returns the measurements. */
static const measurement_t *read_asked(const asked_t *asked, past_t *past, belief_t *belief) {
    const int64_t *times = (const int64_t *)(asked + 1);
    const double *commands = (const double *)(times + asked->known);
    const belief_t *first = (const belief_t *)(commands + 2 * asked->known);
    *past = (past_t){asked->known, times, commands};
    *belief = *first;
    return (const measurement_t *)(first + 1);
}

static int64_t earlier(int64_t a, int64_t b) { return a < b ? a : b; }

/* How many of `times` are not after `t`. */
static int64_t count_until(const past_t *past, int64_t t) {
    int64_t count = past->known;
    while (count && past->times[count - 1] > t) count--;
    return count;
}

/* What the actuators do from `start` to `stop`, as `propagate` takes it; whether the servo is driven. */
static int drive(const setup_t *f, const past_t *past, const double *x, int64_t start, int64_t stop,
                 vec *driven) {
    int64_t turn = count_until(past, start - f->steer_late), push = count_until(past, start - f->drive_late);
    vec in[GIVEN + SO_FAR] = {0}, out[SO_FAR], *so_far = in + GIVEN;
    int steered = 0;
    in[4] = all(x[car_SPEED]);
    so_far[0] = all(x[car_STEER]);
    so_far[3] = so_far[4] = all(1.0);
    for (int64_t begin = start; begin < stop;) {
        int64_t next_turn = turn < past->known ? past->times[turn] + f->steer_late : NEVER_NS;
        int64_t next_push = push < past->known ? past->times[push] + f->drive_late : NEVER_NS;
        int64_t end = earlier(earlier(next_turn, next_push), stop);
        const double *steering = past->commands + 2 * (turn - 1), *driving = past->commands + 2 * (push - 1);
        int pushed = push && !isnan(driving[0]);
        steered = turn && !isnan(steering[0]);
        in[0] = all(steered ? steering[0] : 0.0);
        in[1] = all(steered);
        in[2] = all(pushed ? driving[1] : 0.0);
        in[3] = all(pushed);
        in[5] = all((double)(end - begin) * SECONDS);
        filter_piece(in, out, f->p, f->q, 0.0);
        for (int i = 0; i < SO_FAR; i++) so_far[i] = out[i];
        turn += next_turn == end;
        push += next_push == end;
        begin = end;
    }
    const double span = (double)(stop - start) * SECONDS;
    driven[0] = so_far[0];
    driven[1] = so_far[1] / span;
    driven[2] = so_far[2] / span;
    driven[3] = so_far[3];
    driven[4] = so_far[5] / span;
    driven[5] = (so_far[4] - 1.0) / span;
    return steered;
}

/* C (m, n) = A (m, k) B (k, n), or A B' with B (n, k). */
INLINE void product(int m, int n, int k, const double *A, const double *B, int transposed, double *C) {
    for (int i = 0; i < m; i++)
        for (int j = 0; j < n; j++) {
            double sum = 0.0;
            for (int l = 0; l < k; l++) sum += A[i * k + l] * (transposed ? B[j * k + l] : B[l * n + j]);
            C[i * n + j] = sum;
        }
}

static void step(const setup_t *f, const past_t *past, belief_t *b, int64_t begin, int64_t end) {
    vec in[SIZE + DRIVEN + SIZE + 1], out[SIZE + 2 * SQUARE], *density = in + SIZE + DRIVEN;
    double F[SQUARE], half[SQUARE];
    for (int i = 0; i < SIZE; i++) {
        in[i] = all(b->x[i]);
        density[i] = all(f->density[i]);
    }
    if (!drive(f, past, b->x, begin, end, in + SIZE)) density[SIZE - 1] = all(0.0);
    density[SIZE] = all((double)(end - begin) * SECONDS);
    filter_propagate(in, out, f->p, f->q, 0.0);
    for (int i = 0; i < SIZE; i++) b->x[i] = out[i][0];
    for (int i = 0; i < SQUARE; i++) F[i] = out[SIZE + i][0];
    product(SIZE, SIZE, SIZE, F, b->P, 0, half);
    product(SIZE, SIZE, SIZE, half, F, 1, b->P);
    for (int i = 0; i < SQUARE; i++) b->P[i] += out[SIZE + SQUARE + i][0];
}

/* From `start` to `stop`; the steps depend on the two instants alone, and grow in a long gap. */
static void predict_belief(const setup_t *f, const past_t *past, belief_t *b, int64_t start, int64_t stop) {
    const int64_t span = stop - start;
    const int64_t count = earlier((span + LONGEST_STEP_NS - 1) / LONGEST_STEP_NS, MOST_STEPS);
    int64_t begin = start, whole = count;
    int power = 1;
    for (; power < STEEPEST && span > LONGEST_STEP_NS * whole; power++) whole *= count;
    for (int64_t i = 1; i <= count; i++) {
        int64_t part = i;
        for (int k = 1; k < power; k++) part *= i;
        int64_t end = start + span * part / whole;
        step(f, past, b, begin, end);
        begin = end;
    }
}

/* The lower factor L of A = L L' (n, n); whether there is one. */
INLINE int factor(int n, const double *A, double *L) {
    for (int j = 0; j < n; j++)
        for (int i = j; i < n; i++) {
            double sum = A[i * n + j];
            for (int k = 0; k < j; k++) sum -= L[i * n + k] * L[j * n + k];
            if (i == j && !(sum > 0.0)) return 0;
            L[i * n + j] = i == j ? sqrt(sum) : sum / L[j * n + j];
        }
    return 1;
}

/* The inverse of A (n, n), positive definite; whether it is. */
INLINE int invert(int n, const double *A, double *inverse) {
    double L[WIDEST * WIDEST], column[WIDEST];
    if (!factor(n, A, L)) return 0;
    for (int j = 0; j < n; j++) {
        for (int i = 0; i < n; i++) {
            double sum = i == j ? 1.0 : 0.0;
            for (int k = 0; k < i; k++) sum -= L[i * n + k] * column[k];
            column[i] = sum / L[i * n + i];
        }
        for (int i = n - 1; i >= 0; i--) {
            double sum = column[i];
            for (int k = i + 1; k < n; k++) sum -= L[k * n + i] * column[k];
            inverse[i * n + j] = column[i] = sum / L[i * n + i];
        }
    }
    return 1;
}

/* A measurement fused, the covariance in Joseph's form; writes the innovation's normalised square. */
static void update(const sensor_t *s, belief_t *b, const double *measured, double *nis) {
    const int m = (int)s->count;
    const double gain = s->gain;
    double PHT[SIZE * WIDEST], S[WIDEST * WIDEST], SI[WIDEST * WIDEST], weighed[WIDEST], y[WIDEST];
    double K[SIZE * WIDEST], KR[SIZE * WIDEST], kept[SQUARE], half[SQUARE], added[SQUARE], *P = b->P;
    *nis = INFINITY;
    for (int j = 0; j < m; j++)
        if (!(fabs(measured[j]) < ABSURD)) return;
    for (int i = 0; i < SIZE; i++)
        for (int j = 0; j < m; j++) PHT[i * m + j] = P[i * SIZE + (int)s->state[j]] * gain;
    for (int i = 0; i < m; i++)
        for (int j = 0; j < m; j++)
            S[i * m + j] = gain * PHT[(int)s->state[i] * m + j] + (i == j ? s->variance[i] : 0.0);
    for (int j = 0; j < m; j++) y[j] = measured[j] - gain * b->x[(int)s->state[j]];
    if (s->yaw_row >= 0.0) y[(int)s->yaw_row] = remainder(y[(int)s->yaw_row], 6.283185307179586);
    if (!invert(m, S, SI)) return;
    product(SIZE, m, m, PHT, SI, 0, K);
    product(1, m, m, y, SI, 0, weighed);
    product(1, 1, m, weighed, y, 0, nis);
    for (int i = 0; i < SIZE; i++) {
        double shift = 0.0;
        for (int j = 0; j < m; j++) shift += K[i * m + j] * y[j];
        b->x[i] += shift;
    }
    double I_KH[SQUARE] = {0};
    for (int i = 0; i < SIZE; i++) {
        I_KH[i * SIZE + i] = 1.0;
        for (int j = 0; j < m; j++) {
            I_KH[i * SIZE + (int)s->state[j]] -= K[i * m + j] * gain;
            KR[i * m + j] = K[i * m + j] * s->variance[j];
        }
    }
    product(SIZE, SIZE, SIZE, I_KH, P, 0, half);
    product(SIZE, SIZE, SIZE, half, I_KH, 1, kept);
    product(SIZE, SIZE, m, KR, K, 1, added);
    for (int i = 0; i < SQUARE; i++) kept[i] += added[i];
    for (int i = 0; i < SIZE; i++)
        for (int j = 0; j < SIZE; j++) P[i * SIZE + j] = 0.5 * (kept[i * SIZE + j] + kept[j * SIZE + i]);
}

/* out (count, BELIEF + 2): for each measurement the belief after it (mean, covariance), the
 * innovation's normalised square, and whether it was believed. */
void EXPORT(fuse)(const setup_t *f, const asked_t *asked, double *out) {
    past_t past;
    belief_t belief, prior;
    const measurement_t *measured = read_asked(asked, &past, &belief);
    int64_t start = asked->start;
    for (int64_t i = 0; i < asked->count; i++, out += BELIEF + 2) {
        const sensor_t *sensor = f->sensors + measured[i].kind;
        double nis;
        predict_belief(f, &past, &belief, start, measured[i].t);
        prior = belief;
        update(sensor, &belief, measured[i].values, &nis);
        int believed = nis <= sensor->gate;
        if (!believed) belief = prior;
        memcpy(out, &belief, sizeof belief);
        out[BELIEF] = nis;
        out[BELIEF + 1] = believed;
        start = measured[i].t;
    }
}

/* out (BELIEF + SIZE + 2,): the belief at `stop`, the standard deviation of each state and of the
 * place along its worst direction, and whether the belief is finite with a Cholesky factor. */
void EXPORT(predict)(const setup_t *f, const asked_t *asked, double *out) {
    past_t past;
    belief_t belief;
    double L[SQUARE];
    read_asked(asked, &past, &belief);
    predict_belief(f, &past, &belief, asked->start, asked->stop);
    memcpy(out, &belief, sizeof belief);
    double *sd = out + BELIEF;
    int sound = factor(SIZE, belief.P, L);
    for (int i = 0; i < SIZE; i++) {
        const double variance = belief.P[i * SIZE + i];
        sound &= isfinite(belief.x[i]) && isfinite(variance);
        sd[i] = variance >= 0.0 ? sqrt(variance) : NAN;
    }
    const double a = belief.P[0], b = belief.P[1], c = belief.P[SIZE + 1], d = 0.5 * (a - c);
    sd[SIZE] = sqrt(0.5 * (a + c) + sqrt(d * d + b * b));
    sd[SIZE + 1] = sound;
}

/* in (SIZE + 2,) state, wheel, acceleration; out: the rates and their derivatives. */
void EXPORT(tangent)(const double *p, const double *in, double *out) {
    enum { RATES = SIZE - 1 };
    vec rows[SIZE + 2], found[RATES + RATES * (SIZE + 1)];
    double q[filter_CONSTANTS + 1];
    filter_constants(p, 0.0, q);
    for (int i = 0; i < SIZE + 2; i++) rows[i] = all(in[i]);
    filter_tangent(rows, found, p, q, 0.0);
    for (int i = 0; i < RATES + RATES * (SIZE + 1); i++) out[i] = found[i][0];
}

void EXPORT(filter_constants)(const double *p, double h, double *q) { filter_constants(p, h, q); }
int64_t EXPORT(filter_constant_count)(void) { return filter_CONSTANTS; }
