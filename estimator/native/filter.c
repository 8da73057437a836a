/* Beliefs predicted and fused as `steerd.estimator` does it, operation for operation.
 *
 * The equations come printed (equations.h). What stands here is the order of the steps: which
 * command holds when, how an interval is divided, which matrices are multiplied. Sums of products
 * go through the BLAS and LAPACK that Python was given, because their order of summation is part of
 * the result; products with a single term are written out. Compiled without contraction of
 * products and sums. The names are those of the Python files, which have the reasons.
 *
 * A status other than 0 means that a number is not finite or a covariance has no factor: the
 * caller discards the outcome and lets Python say what is wrong.
 */
#include <stdint.h>
#include <string.h>

#include "equations.h"

#define SECONDS 1e-9
#define NEVER_NS ((int64_t)1 << 62)

enum { SQUARE = SIZE * SIZE, BELIEF = SIZE + SQUARE, WIDEST = 3, KINDS = 3, NODE = BELIEF + 5 };

typedef void product_t(char *, char *, int *, int *, int *, double *, double *, int *, double *,
                       int *, double *, double *, int *);
typedef void apply_t(char *, int *, int *, double *, double *, int *, double *, int *, double *,
                     double *, int *);
typedef double dot_t(int *, double *, int *, double *, int *);
typedef void solve_t(char *, int *, int *, double *, int *, double *, int *, int *);
typedef void factor_t(char *, int *, double *, int *, int *);

static struct {
    product_t *product;
    apply_t *apply;
    dot_t *dot;
    solve_t *solve;
    factor_t *factor;
} lapack;

/* One instrument, as `sensors.Sensor`: one reading of each state named, times the gain. */
typedef struct {
    double count, state[WIDEST], gain, variance[WIDEST], gate, yaw_row;
} sensor_t;

/* What does not change while a filter runs. */
typedef struct {
    double car[CAR], density[SIZE], lateral, steer_late_ns, drive_late_ns, chassis;
    sensor_t sensors[KINDS];
} setup_t;

/* The commands of the recent past, in the order of their times. */
typedef struct {
    int64_t known;
    const int64_t *times;
    const double *commands; /* steer, speed; not a number where nothing was driven */
} history_t;

typedef struct {
    double x[SIZE], P[SQUARE];
} belief_t;

/* What is asked: two instants; the times of the commands, the commands and the belief follow. */
typedef struct {
    int64_t known, start, stop;
} asked_t;

typedef struct {
    int64_t t, kind;
    double values[WIDEST];
} measurement_t;

/* The functions dgemm, dgemv, ddot, dposv and dpotrf, in this order. */
void attach(void *const *functions)
{
    memcpy(&lapack, functions, sizeof lapack);
}

static int finite(const double *values, int count)
{
    for (int i = 0; i < count; i++)
        if (!isfinite(values[i]))
            return 0;
    return 1;
}

/* C (m, n) = A (m, k) B (k, n), or A B' with B (n, k); all by rows. */
static void product(int m, int n, int k, const double *A, const double *B, int transposed, double *C)
{
    double one = 1.0, zero = 0.0;
    char as_is = 'N', b = transposed ? 'T' : 'N';
    int width = transposed ? k : n;
    lapack.product(&b, &as_is, &n, &m, &k, &one, (double *)B, &width, (double *)A, &k, &zero, C, &n);
}

/* y (m) = A (m, n) x, A by rows. */
static void apply(int m, int n, const double *A, const double *x, double *y)
{
    double one = 1.0, zero = 0.0;
    char transposed = 'T';
    int step = 1;
    lapack.apply(&transposed, &n, &m, &one, (double *)A, &n, (double *)x, &step, &zero, y, &step);
}

/* Where of `times` the first one after `t` is. */
static int64_t after(const history_t *history, int64_t t)
{
    int64_t low = 0, high = history->known;
    while (low < high) {
        int64_t middle = (low + high) / 2;
        if (history->times[middle] <= t)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

static int64_t earlier(int64_t a, int64_t b)
{
    return a < b ? a : b;
}

/* `actuation.drive`: fills `driven` as the equations take it; returns whether it is steered. */
static int drive(const setup_t *setup, const history_t *history, double steer, double speed,
                 int64_t start, int64_t stop, double *driven)
{
    const int64_t steer_late = (int64_t)setup->steer_late_ns;
    const int64_t drive_late = (int64_t)setup->drive_late_ns;
    int64_t turn = after(history, start - steer_late), push = after(history, start - drive_late);
    double in[GIVEN + SO_FAR] = {0.0, 0.0, 0.0, 0.0, speed, 0.0, steer, 0.0, 0.0, 1.0, 1.0, 0.0};
    double *so_far = in + GIVEN, out[SO_FAR];
    for (int64_t begin = start; begin < stop;) {
        int64_t next_turn = turn < history->known ? history->times[turn] + steer_late : NEVER_NS;
        int64_t next_push = push < history->known ? history->times[push] + drive_late : NEVER_NS;
        int64_t end = earlier(earlier(next_turn, next_push), stop);
        const double *steering = history->commands + 2 * (turn - 1);
        const double *driving = history->commands + 2 * (push - 1);
        in[1] = turn && !isnan(steering[0]);
        in[0] = in[1] > 0.0 ? steering[0] : 0.0;
        in[3] = push && !isnan(driving[0]);
        in[2] = in[3] > 0.0 ? driving[1] : 0.0;
        in[5] = (double)(end - begin) * SECONDS;
        piece(setup->car, in, out);
        memcpy(so_far, out, sizeof out);
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
    return in[1] > 0.0;
}

/* `Kalman.predict`: P = F P F' + Q. */
static void carry(double *P, const double *F, const double *Q)
{
    double half[SQUARE];
    product(SIZE, SIZE, SIZE, F, P, 0, half);
    product(SIZE, SIZE, SIZE, half, F, 1, P);
    for (int i = 0; i < SQUARE; i++)
        P[i] = P[i] + Q[i];
}

/* `motion._step`. */
static void step(const setup_t *setup, const history_t *history, belief_t *belief, int64_t begin,
                 int64_t end)
{
    double in[SIZE + 6 + SIZE + 1], out[SIZE + 2 * SQUARE];
    double *driven = in + SIZE, *density = driven + 6;
    const double *x = belief->x, lateral[2] = {setup->lateral, x[3]};
    memcpy(in, x, sizeof belief->x);
    int steered = drive(setup, history, x[6], x[3], begin, end, driven);
    memcpy(density, setup->density, sizeof setup->density);
    slip_noise(setup->car, lateral, density + 5);
    if (!steered)
        density[6] = 0.0;
    density[SIZE] = (double)(end - begin) * SECONDS;
    propagate[(int)setup->chassis](setup->car, in, out);
    memcpy(belief->x, out, sizeof belief->x);
    carry(belief->P, out + SIZE, out + SIZE + SQUARE);
}

/* `motion.predict_belief`. */
static void predict_belief(const setup_t *setup, const history_t *history, belief_t *belief,
                           int64_t start, int64_t stop)
{
    const int64_t span = stop - start;
    const int64_t count = earlier((span + LONGEST_STEP_NS - 1) / LONGEST_STEP_NS, MOST_STEPS);
    int64_t begin = start, whole = count;
    int power = 1;
    for (; power < STEEPEST && span > LONGEST_STEP_NS * whole; power++)
        whole *= count;
    for (int64_t i = 1; i <= count; i++) {
        int64_t part = i;
        for (int k = 1; k < power; k++)
            part *= i;
        int64_t end = start + span * part / whole;
        step(setup, history, belief, begin, end);
        begin = end;
    }
}

/* `Kalman.update` of a sensor that reads one state each, up to the sums. */
static int update(const sensor_t *sensor, belief_t *belief, const double *measured, double *y,
                  double *nis)
{
    int m = (int)sensor->count, failed = 0, unit = 1;
    char upper = 'U';
    double gain = sensor->gain, *x = belief->x, *P = belief->P, shift[SIZE];
    double PHT[SIZE * WIDEST], S[WIDEST * WIDEST], SI[WIDEST * WIDEST], K[SIZE * WIDEST];
    double KR[SIZE * WIDEST], I_KH[SQUARE], half[SQUARE], kept[SQUARE], added[SQUARE];
    for (int i = 0; i < SIZE; i++)
        for (int j = 0; j < m; j++)
            PHT[i * m + j] = P[i * SIZE + (int)sensor->state[j]] * gain;
    for (int i = 0; i < m; i++)
        for (int j = 0; j < m; j++) {
            double spread = gain * PHT[(int)sensor->state[i] * m + j];
            S[i + j * m] = i == j ? spread + sensor->variance[i] : spread;
            SI[i + j * m] = i == j ? 1.0 : 0.0;
        }
    lapack.solve(&upper, &m, &m, S, &m, SI, &m, &failed);
    if (failed)
        return 1;
    for (int j = 0; j < m; j++)
        y[j] = measured[j] - gain * x[(int)sensor->state[j]];
    if (sensor->yaw_row >= 0.0)
        y[(int)sensor->yaw_row] = remainder(y[(int)sensor->yaw_row], 6.283185307179586);
    if (m == 1) {
        for (int i = 0; i < SIZE; i++) {
            K[i] = PHT[i] * SI[0];
            shift[i] = K[i] * y[0];
        }
        *nis = y[0] * SI[0] * y[0];
    } else {
        double weighed[WIDEST];
        product(SIZE, m, m, PHT, SI, 1, K); /* SI lies by columns */
        apply(SIZE, m, K, y, shift);
        apply(m, m, SI, y, weighed);
        *nis = lapack.dot(&m, weighed, &unit, y, &unit);
    }
    for (int i = 0; i < SIZE; i++) {
        x[i] = x[i] + shift[i];
        for (int j = 0; j < SIZE; j++)
            I_KH[i * SIZE + j] = i == j ? 1.0 : 0.0;
        for (int j = 0; j < m; j++) {
            int column = (int)sensor->state[j];
            I_KH[i * SIZE + column] = (i == column ? 1.0 : 0.0) - K[i * m + j] * gain;
            KR[i * m + j] = K[i * m + j] * sensor->variance[j];
        }
    }
    product(SIZE, SIZE, SIZE, I_KH, P, 0, half);
    product(SIZE, SIZE, SIZE, half, I_KH, 1, kept);
    product(SIZE, SIZE, m, KR, K, 1, added);
    for (int i = 0; i < SQUARE; i++)
        kept[i] = kept[i] + added[i];
    for (int i = 0; i < SIZE; i++)
        for (int j = 0; j < SIZE; j++)
            P[i * SIZE + j] = 0.5 * (kept[i * SIZE + j] + kept[j * SIZE + i]);
    return 0;
}

/* Where the commands and the belief of a question lie; returns what follows them. */
static const void *read_asked(const asked_t *asked, history_t *history, belief_t *belief)
{
    const int64_t *times = (const int64_t *)(asked + 1);
    const double *commands = (const double *)(times + asked->known);
    const belief_t *first = (const belief_t *)(commands + 2 * asked->known);
    *history = (history_t){asked->known, times, commands};
    *belief = *first;
    return first + 1;
}

/* The chain of nodes after a belief of `start`: for each measurement the belief after it (mean,
 * covariance), the innovation (3), its square, and whether it was believed. */
int fuse(const setup_t *setup, const asked_t *asked, int count, double *out)
{
    history_t history;
    belief_t belief, prior;
    const measurement_t *measured = read_asked(asked, &history, &belief);
    int64_t start = asked->start;
    for (int i = 0; i < count; i++, out += NODE) {
        const sensor_t *sensor = setup->sensors + measured[i].kind;
        double y[WIDEST] = {0.0, 0.0, 0.0}, nis = 0.0;
        predict_belief(setup, &history, &belief, start, measured[i].t);
        prior = belief;
        if (update(sensor, &belief, measured[i].values, y, &nis))
            return 1;
        int believed = nis <= sensor->gate;
        if (!finite(prior.x, BELIEF) || !finite(belief.x, BELIEF) || !isfinite(nis))
            return 1;
        if (!believed)
            belief = prior;
        memcpy(out, &belief, sizeof belief);
        memcpy(out + BELIEF, y, sizeof y);
        out[BELIEF + WIDEST] = nis;
        out[BELIEF + WIDEST + 1] = believed;
        start = measured[i].t;
    }
    return 0;
}

/* The belief at `stop`, and whether its covariance has a Cholesky factor. */
int predict(const setup_t *setup, const asked_t *asked, double *out)
{
    history_t history;
    belief_t belief;
    double by_columns[SQUARE];
    char upper = 'U';
    int size = SIZE, failed = 0;
    read_asked(asked, &history, &belief);
    predict_belief(setup, &history, &belief, asked->start, asked->stop);
    if (!finite(belief.x, BELIEF))
        return 1;
    memcpy(out, &belief, sizeof belief);
    for (int i = 0; i < SIZE; i++)
        for (int j = 0; j < SIZE; j++)
            by_columns[i + j * SIZE] = belief.P[i * SIZE + j];
    lapack.factor(&upper, &size, by_columns, &size, &failed);
    out[BELIEF] = failed == 0;
    return 0;
}

/* What the check at loading compares with Python: one prediction's and one update's algebra. */
int try_algebra(const sensor_t *sensor, belief_t *belief, const double *F, const double *Q,
                const double *measured, double *y, double *nis)
{
    carry(belief->P, F, Q);
    return update(sensor, belief, measured, y, nis);
}
