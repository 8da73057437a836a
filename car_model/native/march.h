/* The loops around the printed pieces of a model: windows side by side in the slots of a row.
 *
 * Actuators are exact over a step, wheels move linearly within it, memory follows at its end; Euler
 * and Runge-Kutta are one loop (stage i starts from the slope of stage i - 1). Every function does
 * one block of SLOTS windows. A direction of the sensitivities is rows of the same slots.
 */

enum {
    N = car_STATES + car_MEMORY, /* numbers of a state */
    CHASSIS = car_CHASSIS, STEER = car_STEER, MEMORY = car_MEMORY, STATES = car_STATES,
    MOST_STAGES = 4,
    FLUSH_EVERY = 64 /* steps between removals of denormal numbers */
};
#define DENORMAL_GUARD 1e-100
#define M car_MEMORY + 1 /* no array is empty */

typedef struct {
    const double *p, *q, *tableau; /* parameters, constants, (2, stages) node and weight */
    double h;
    int64_t stages, substeps;
} integration_t;

typedef struct {
    const double *commands; /* (rows, 2) */
    const int64_t *spans;   /* (SLOTS, 5) first row, after the last, at the start, steps, settling */
    const double *t;        /* (SLOTS,) time into the run at the start */
} block_t;

/* -- commands ---------------------------------------------------------------------------------- */

typedef struct {
    vec *rows; /* steer and speed in turn */
    int64_t first, length, whole[2];
    double part[2];
} stream_t;

INLINE int64_t down(double x) {
    int64_t n = (int64_t)x;
    return n - (n > x);
}
INLINE int64_t divide(int64_t a, int64_t b) { return a / b - (a % b < 0); }
INLINE int64_t command_row(const block_t *b, int slot, int64_t k) {
    const int64_t *s = b->spans + 5 * slot, row = s[2] + k;
    return row < s[0] ? s[0] : row > s[1] - 1 ? s[1] - 1 : row;
}

static void delays_in_steps(const integration_t *m, vec *steps) {
    car_delays(0, steps, m->p, m->q, m->h);
    for (int i = 0; i < 3; i++) steps[i] = steps[i] / m->h;
}

static stream_t make_stream(const integration_t *m, const block_t *b, int64_t from, int64_t to) {
    vec delays[3];
    delays_in_steps(m, delays);
    stream_t s = {0};
    for (int c = 0; c < 2; c++) {
        s.whole[c] = down(delays[c][0]);
        s.part[c] = delays[c][0] - (double)s.whole[c];
    }
    int64_t late = s.whole[0] > s.whole[1] ? s.whole[0] : s.whole[1];
    int64_t early = s.whole[0] < s.whole[1] ? s.whole[0] : s.whole[1];
    s.first = divide(from - late - 1, m->substeps);
    s.length = divide(to - early, m->substeps) - s.first + 1;
    s.rows = aligned_alloc(64, 2 * s.length * sizeof(vec));
    for (int slot = 0; slot < SLOTS; slot++)
        for (int64_t i = 0; i < s.length; i++) {
            const double *at = b->commands + 2 * command_row(b, slot, s.first + i);
            s.rows[2 * i][slot] = at[0];
            s.rows[2 * i + 1][slot] = at[1];
        }
    return s;
}
INLINE int64_t newer(const integration_t *m, const stream_t *s, int64_t k, int c) {
    return 2 * (divide(k - s->whole[c], m->substeps) - s->first) + c;
}
INLINE int64_t older(const integration_t *m, const stream_t *s, int64_t k, int c) {
    return 2 * (divide(k - s->whole[c] - 1, m->substeps) - s->first) + c;
}
INLINE void delayed(const integration_t *m, const stream_t *s, int64_t k, vec *in) {
    for (int c = 0; c < 2; c++) {
        in[car_ACTUATORS_COMMAND + c] = s->rows[newer(m, s, k, c)];
        in[car_ACTUATORS_OLDER + c] = s->rows[older(m, s, k, c)];
        in[car_ACTUATORS_SHARE + c] = all(s->part[c]);
    }
}

/* -- values of a step ---------------------------------------------------------------------------- */

typedef struct {
    vec in[car_ACTUATORS_INPUTS], out[car_ACTUATORS_OUTPUTS];
    vec rates_in[car_RATES_INPUTS], slope[car_CHASSIS];
    vec remember_in[car_REMEMBER_INPUTS], remember_out[M];
    vec *actuators_j, *rates_j, *remember_j, *observe_j; /* derivatives, of each stage */
    const uint8_t *moved;                               /* none: no derivatives */
} step_t;

INLINE void actuate(const integration_t *m, step_t *s, const vec *now, vec t, int64_t k) {
    for (int i = 0; i < N; i++) s->in[i] = now[i];
    s->in[car_ACTUATORS_TIME] = t + (double)k * m->h;
    if (s->moved)
        car_actuators_jac(s->in, s->out, s->actuators_j, s->moved, m->p, m->q, m->h);
    else
        car_actuators(s->in, s->out, m->p, m->q, m->h);
}

INLINE void set_stage(const integration_t *m, step_t *s, int stage) {
    double node = m->tableau[stage], step = m->h * node;
    for (int i = 0; i < CHASSIS; i++)
        s->rates_in[i] = stage ? s->in[i] + step * s->slope[i] : s->in[i];
    s->rates_in[car_RATES_WHEEL] =
        (1.0 - node) * s->out[car_WHEEL_START] + node * s->out[car_WHEEL_END];
}

INLINE void march_step(const integration_t *m, step_t *s, vec *after) {
    vec *r = s->rates_in, sum[car_CHASSIS];
    r[car_RATES_ACCEL] = s->out[car_ACCEL];
    for (int i = 0; i < MEMORY; i++) r[car_RATES_ACCEL + 1 + i] = s->out[car_MEMORY_END + i];
    r[car_RATES_TIME] = s->in[car_ACTUATORS_TIME];
    for (int i = 0; i < CHASSIS; i++) sum[i] = s->in[i];
    for (int stage = 0; stage < m->stages; stage++) {
        set_stage(m, s, stage);
        vec *j = s->rates_j + stage * car_rates_SLOPES;
        if (all_above(r[car_SPEED], FAST_SPEED)) {
            if (s->moved) car_fast_jac(r, s->slope, j, s->moved, m->p, m->q, m->h);
            else car_fast(r, s->slope, m->p, m->q, m->h);
        } else {
            if (s->moved) car_rates_jac(r, s->slope, j, s->moved, m->p, m->q, m->h);
            else car_rates(r, s->slope, m->p, m->q, m->h);
        }
        double share = m->h * m->tableau[m->stages + stage];
        for (int i = 0; i < CHASSIS; i++) sum[i] += share * s->slope[i];
    }
    for (int i = 0; i < CHASSIS; i++) after[i] = sum[i];
    after[STEER] = s->out[car_STEER_END];
    for (int i = 0; i < MEMORY; i++) after[STATES + i] = s->out[car_MEMORY_END + i];
}

INLINE void remember(const integration_t *m, step_t *s, vec *after) {
    if (!car_REMEMBERS) return;
    vec *r = s->remember_in;
    for (int i = 0; i < CHASSIS; i++) {
        r[i] = s->in[i];
        r[car_REMEMBER_AFTER + i] = after[i];
    }
    r[STEER] = s->out[car_WHEEL_START];
    r[car_REMEMBER_AFTER + STEER] = s->out[car_WHEEL_END];
    for (int i = 0; i < MEMORY; i++) r[car_REMEMBER_MEMORY + i] = s->out[car_MEMORY_END + i];
    r[car_REMEMBER_TIME] = s->in[car_ACTUATORS_TIME];
    if (s->moved)
        car_remember_jac(r, s->remember_out, s->remember_j, s->moved, m->p, m->q, m->h);
    else
        car_remember(r, s->remember_out, m->p, m->q, m->h);
    for (int i = 0; i < MEMORY; i++) after[STATES + i] = s->remember_out[i];
}

static vec *new_rows(int64_t count) { return aligned_alloc(64, (count + 1) * sizeof(vec)); }

/* The derivatives of one step, of all its pieces. */
static vec *make_slopes(step_t *s, int64_t stages) {
    vec *rows = new_rows(car_actuators_SLOPES + stages * car_rates_SLOPES + car_remember_SLOPES
                        + car_observe_SLOPES);
    s->actuators_j = rows;
    s->rates_j = s->actuators_j + car_actuators_SLOPES;
    s->remember_j = s->rates_j + stages * car_rates_SLOPES;
    s->observe_j = s->remember_j + car_remember_SLOPES;
    return rows;
}

/* -- windows of equal length: values ------------------------------------------------------------- */

/* path: (steps + 1, N, slots); the first state is given, the others are written. */
void EXPORT(march)(const integration_t *m, const block_t *b, int64_t steps, int64_t slots, double *path) {
    stream_t stream = make_stream(m, b, 0, steps);
    step_t s = {0};
    vec now[N], t = load(b->t);
    for (int i = 0; i < N; i++) now[i] = load(path + i * slots);
    for (int64_t k = 0; k < steps; k++) {
        delayed(m, &stream, k, s.in);
        actuate(m, &s, now, t, k);
        march_step(m, &s, now);
        remember(m, &s, now);
        for (int i = 0; i < N; i++) store(path + ((k + 1) * N + i) * slots, now[i]);
    }
    free(stream.rows);
}

/* -- their adjoint ---------------------------------------------------------------------------------- */

typedef struct {
    const double *values; /* derivatives of a loss by every state */
    int64_t by_window, by_moment, by_state, windows, slot;
} loss_t;

INLINE void add_loss(const loss_t *loss, int64_t k, vec *bar) {
    const double *from = loss->values + loss->slot * loss->by_window + k * loss->by_moment;
    if (loss->by_window == 1 && loss->slot + SLOTS <= loss->windows) {
        for (int i = 0; i < N; i++) bar[i] += load(from + i * loss->by_state);
        return;
    }
    for (int slot = 0; slot < SLOTS && loss->slot + slot < loss->windows; slot++)
        for (int i = 0; i < N; i++) bar[i][slot] += from[slot * loss->by_window + i * loss->by_state];
}

/* Written: first (N, SLOTS); added to: parameters (P,), delays (2,), commands (rows, 2) or none. */
void EXPORT(march_back)(const integration_t *m, const block_t *b, int64_t steps, int64_t slots,
                        const double *path, const loss_t *loss, double *first, double *parameters,
                        double *delays, double *commands) {
    stream_t stream = make_stream(m, b, 0, steps);
    uint8_t moved[car_PARAMETER_COUNT];
    memset(moved, 1, sizeof moved);
    step_t s = {.moved = moved};
    vec *slopes = make_slopes(&s, m->stages), t = load(b->t), now[N], after[N], bar[N] = {0};
    vec by[car_PARAMETER_COUNT] = {0}, by_delay[2] = {0};
    vec *returned = commands ? new_rows(2 * stream.length) : 0;
    if (commands) memset(returned, 0, 2 * stream.length * sizeof(vec));
    add_loss(loss, steps, bar);
    for (int64_t k = steps - 1; k >= 0; k--) {
        for (int i = 0; i < N; i++) now[i] = load(path + (k * N + i) * slots);
        delayed(m, &stream, k, s.in);
        actuate(m, &s, now, t, k);
        march_step(m, &s, after);
        remember(m, &s, after);
        vec actuated[car_ACTUATORS_OUTPUTS] = {0}, start[N] = {0};
        actuated[car_STEER_END] = bar[STEER];
        for (int i = 0; i < MEMORY; i++) actuated[car_MEMORY_END + i] = bar[STATES + i];
        if (car_REMEMBERS) {
            vec x[car_REMEMBER_INPUTS] = {0}, *own = bar + STATES;
            car_remember_pull(s.remember_j, own, x, by);
            actuated[car_WHEEL_START] += x[STEER];
            actuated[car_WHEEL_END] += x[car_REMEMBER_AFTER + STEER];
            for (int i = 0; i < MEMORY; i++) actuated[car_MEMORY_END + i] = x[car_REMEMBER_MEMORY + i];
            for (int i = 0; i < CHASSIS; i++) {
                bar[i] += x[car_REMEMBER_AFTER + i];
                start[i] += x[i];
            }
        }
        for (int i = 0; i < CHASSIS; i++) start[i] += bar[i];
        vec x[car_RATES_INPUTS] = {0};
        double carried = 0.0;
        for (int64_t stage = m->stages - 1; stage >= 0; stage--) {
            const vec *j = s.rates_j + stage * car_rates_SLOPES;
            double node = m->tableau[stage], share = m->h * m->tableau[m->stages + stage];
            vec weight[car_CHASSIS];
            for (int i = 0; i < CHASSIS; i++) weight[i] = share * bar[i] + carried * x[i];
            for (int i = 0; i < car_RATES_INPUTS; i++) x[i] = all(0.0);
            car_rates_pull(j, weight, x, by);
            for (int i = 0; i < CHASSIS; i++) start[i] += x[i];
            actuated[car_WHEEL_START] += (1.0 - node) * x[car_RATES_WHEEL];
            actuated[car_WHEEL_END] += node * x[car_RATES_WHEEL];
            for (int i = 0; i < 1 + MEMORY; i++) actuated[car_ACCEL + i] += x[car_RATES_ACCEL + i];
            carried = m->h * node;
        }
        vec y[car_ACTUATORS_INPUTS] = {0};
        car_actuators_pull(s.actuators_j, actuated, y, by);
        for (int i = 0; i < N; i++) bar[i] = y[i] + start[i];
        add_loss(loss, k, bar);
        for (int c = 0; c < 2; c++) {
            by_delay[c] += y[car_ACTUATORS_SHARE + c];
            if (commands) {
                returned[newer(m, &stream, k, c)] += y[car_ACTUATORS_COMMAND + c];
                returned[older(m, &stream, k, c)] += y[car_ACTUATORS_OLDER + c];
            }
        }
    }
    for (int slot = 0; slot < SLOTS; slot++) {
        for (int i = 0; i < car_PARAMETER_COUNT; i++) parameters[i] += by[i][slot];
        for (int c = 0; c < 2; c++) delays[c] += by_delay[c][slot];
        for (int64_t i = 0; commands && i < 2 * stream.length; i++)
            commands[2 * command_row(b, slot, stream.first + i / 2) + i % 2] += returned[i][slot];
    }
    for (int i = 0; i < N; i++) store(first + i * SLOTS, bar[i]);
    free(returned);
    free(slopes);
    free(stream.rows);
}

/* -- windows of any lengths, with forward sensitivities ------------------------------------------ */

typedef struct {
    int64_t n;
    const uint8_t *moved; /* (P,) parameters that some direction moves */
    const double *seeds;  /* (P, n) */
    const double *first;  /* (STATES, n) of the first state */
    const double *delays; /* (3, n) of the dead times in steps */
} directions_t;

typedef struct {
    const int64_t *stations; /* (S, 4) step, first reading, row, 1 for a pose; by window and time */
    const double *shares;    /* (S,) of a step */
    const int64_t *ranges;   /* (SLOTS, 2) of each window */
    double *y, *jy;          /* (rows,), (rows, n): written */
} readings_t;

/* What parameters add to the outputs of a piece, by direction. */
typedef struct {
    int32_t slope, output;
    double scale;
} entry_t;
typedef struct {
    entry_t *entries;
    int32_t *ends; /* of each direction's, after a first 0 */
} scatter_t;

static scatter_t make_scatter(const by_t *by, int count, const directions_t *d) {
    int total = 0;
    for (int e = 0; e < count; e++)
        if (d->moved[by[e].parameter])
            for (int i = 0; i < d->n; i++) total += d->seeds[by[e].parameter * d->n + i] != 0.0;
    scatter_t s = {malloc((total + 1) * sizeof(entry_t)), malloc((d->n + 1) * sizeof(int32_t))};
    total = 0;
    for (int i = 0; i < d->n; i++) {
        s.ends[i] = total;
        for (int e = 0; e < count; e++) {
            double scale = d->seeds[by[e].parameter * d->n + i];
            if (scale != 0.0) s.entries[total++] = (entry_t){by[e].slope, by[e].output, scale};
        }
    }
    s.ends[d->n] = total;
    return s;
}
INLINE void scatter(const scatter_t *s, int64_t d, const vec *j, vec *out) {
    for (int e = s->ends[d]; e < s->ends[d + 1]; e++)
        out[s->entries[e].output] += j[s->entries[e].slope] * s->entries[e].scale;
}
static void free_scatter(scatter_t s) {
    free(s.entries);
    free(s.ends);
}

typedef struct {
    scatter_t actuators, rates, remember, observe;
} scatters_t;

INLINE void push_actuators(const directions_t *d, const scatters_t *by, const step_t *s, int64_t i,
                           const vec *dx, vec *in, vec *out) {
    for (int row = 0; row < N; row++) in[row] = dx[row];
    for (int row = N; row < car_ACTUATORS_INPUTS; row++) in[row] = all(0.0);
    for (int c = 0; c < 2; c++) in[car_ACTUATORS_SHARE + c] = all(d->delays[c * d->n + i]);
    for (int row = 0; row < car_ACTUATORS_OUTPUTS; row++) out[row] = all(0.0);
    scatter(&by->actuators, i, s->actuators_j, out);
    car_actuators_push(s->actuators_j, in, out);
}

static void push_step(const integration_t *m, const directions_t *d, const scatters_t *by,
                      const step_t *s, int64_t i, const vec *restrict dx, vec *restrict after) {
    vec in[car_ACTUATORS_INPUTS], out[car_ACTUATORS_OUTPUTS];
    push_actuators(d, by, s, i, dx, in, out);
    vec r[car_RATES_INPUTS], slope[car_CHASSIS], sum[car_CHASSIS];
    for (int row = 0; row < 1 + MEMORY; row++) r[car_RATES_ACCEL + row] = out[car_ACCEL + row];
    for (int row = 0; row < CHASSIS; row++) {
        slope[row] = all(0.0);
        sum[row] = dx[row];
    }
    for (int stage = 0; stage < m->stages; stage++) {
        const vec *j = s->rates_j + stage * car_rates_SLOPES;
        double node = m->tableau[stage], step = m->h * node;
        for (int row = 0; row < CHASSIS; row++) r[row] = dx[row] + step * slope[row];
        r[car_RATES_WHEEL] = (1.0 - node) * out[car_WHEEL_START] + node * out[car_WHEEL_END];
        vec own[car_CHASSIS] = {0};
        scatter(&by->rates, i, j, own);
        for (int row = 0; row < CHASSIS; row++) slope[row] = own[row];
        car_rates_push(j, r, slope);
        double share = m->h * m->tableau[m->stages + stage];
        for (int row = 0; row < CHASSIS; row++) sum[row] += share * slope[row];
    }
    if (car_REMEMBERS) {
        vec x[car_REMEMBER_INPUTS], own[M] = {0};
        for (int row = 0; row < CHASSIS; row++) {
            x[row] = dx[row];
            x[car_REMEMBER_AFTER + row] = sum[row];
        }
        x[STEER] = out[car_WHEEL_START];
        x[car_REMEMBER_AFTER + STEER] = out[car_WHEEL_END];
        for (int row = 0; row < MEMORY; row++) x[car_REMEMBER_MEMORY + row] = out[car_MEMORY_END + row];
        scatter(&by->remember, i, s->remember_j, own);
        car_remember_push(s->remember_j, x, own);
        for (int row = 0; row < MEMORY; row++) after[STATES + row] = own[row];
    } else {
        for (int row = 0; row < MEMORY; row++) after[STATES + row] = out[car_MEMORY_END + row];
    }
    for (int row = 0; row < CHASSIS; row++) after[row] = sum[row];
    after[STEER] = out[car_STEER_END];
}

/* Actuators alone over the known commands before each window: its steer and memory. */
static void settle(const integration_t *m, const block_t *b, const directions_t *d,
                   const scatters_t *by, const stream_t *stream, int64_t longest, step_t *s, vec *now,
                   vec *dx) {
    vec t = load(b->t), first = now[STEER];
    bits settling;
    for (int slot = 0; slot < SLOTS; slot++) settling[slot] = b->spans[5 * slot + 4];
    for (int64_t k = -longest; k < 0; k++) {
        bits begin = settling == -k, keep = settling >= -k;
        delayed(m, stream, k, s->in);
        vec newer = s->in[car_ACTUATORS_COMMAND], gap = s->in[car_ACTUATORS_OLDER] - newer;
        now[STEER] = pick(begin, newer + stream->part[0] * gap, now[STEER]);
        actuate(m, s, now, t, k);
        now[STEER] = pick(keep, s->out[car_STEER_END], now[STEER]);
        for (int i = 0; i < MEMORY; i++)
            now[STATES + i] = pick(keep, s->out[car_MEMORY_END + i], now[STATES + i]);
        for (int64_t i = 0; i < d->n; i++, dx += N) {
            vec in[car_ACTUATORS_INPUTS], out[car_ACTUATORS_OUTPUTS];
            dx[STEER] = pick(begin, gap * d->delays[i], dx[STEER]);
            push_actuators(d, by, s, i, dx, in, out);
            dx[STEER] = pick(keep, out[car_STEER_END], dx[STEER]);
            for (int row = 0; row < MEMORY; row++)
                dx[STATES + row] = pick(keep, out[car_MEMORY_END + row], dx[STATES + row]);
        }
        dx -= N * d->n;
    }
    now[STEER] = pick(settling > 0, now[STEER] + first, now[STEER]);
}

/* The stations that lie within step k, one of each window at a time. */
static void read_stations(const integration_t *m, const block_t *b, const directions_t *d,
                          const scatters_t *by, const readings_t *r, int64_t k, int64_t *station,
                          const step_t *s, const vec *now, const vec *after, const vec *dx,
                          const vec *dx_after) {
    for (;;) {
        struct { int64_t row, lane; } write[3 * SLOTS];
        int count = 0;
        vec share = all(0.0), late = all(0.0), x[STATES], move[STATES], seen[car_READINGS];
        for (int slot = 0; slot < SLOTS; slot++) {
            int64_t at = station[slot], steps = b->spans[5 * slot + 3];
            const int64_t *place = r->stations + 4 * at;
            if (k >= steps || at >= r->ranges[2 * slot + 1] || (place[0] > k && k < steps - 1)) continue;
            station[slot]++;
            share[slot] = r->shares[at] + (double)(place[0] - k);
            late[slot] = (double)place[3];
            for (int c = 0; c < (place[3] ? 3 : 1); c++) {
                write[count].row = place[2] + c;
                write[count++].lane = (place[1] + c) * SLOTS + slot;
            }
        }
        if (!count) return;
        for (int row = 0; row < STATES; row++) {
            move[row] = after[row] - now[row];
            x[row] = now[row] + share * move[row];
        }
        if (s->moved) car_observe_jac(x, seen, s->observe_j, s->moved, m->p, m->q, m->h);
        else car_observe(x, seen, m->p, m->q, m->h);
        for (int e = 0; e < count; e++) r->y[write[e].row] = ((const double *)seen)[write[e].lane];
        vec left = 1.0 - share;
        for (int64_t i = 0; i < d->n; i++) {
            const vec *here = dx + i * N, *next = dx_after + i * N;
            vec in[STATES], out[car_READINGS] = {0}, drift = late * -d->delays[2 * d->n + i];
            scatter(&by->observe, i, s->observe_j, out);
            for (int row = 0; row < STATES; row++)
                in[row] = left * here[row] + share * next[row] + drift * move[row];
            car_observe_push(s->observe_j, in, out);
            for (int e = 0; e < count; e++)
                r->jy[write[e].row * d->n + i] = ((const double *)out)[write[e].lane];
        }
    }
}

/* First states (N, SLOTS) with steer and memory as the commands before the windows bring them. */
void EXPORT(settled)(const integration_t *m, const block_t *b, double *state) {
    int64_t longest = 0;
    for (int slot = 0; slot < SLOTS; slot++)
        if (b->spans[5 * slot + 4] > longest) longest = b->spans[5 * slot + 4];
    stream_t stream = make_stream(m, b, -longest, 0);
    directions_t none = {0};
    step_t s = {0};
    vec now[N];
    for (int i = 0; i < N; i++) now[i] = load(state + i * SLOTS);
    settle(m, b, &none, 0, &stream, longest, &s, now, 0);
    for (int i = 0; i < N; i++) store(state + i * SLOTS, now[i]);
    free(stream.rows);
}

/* Readings of a block's windows, and their derivatives; first: (N, SLOTS) states. */
void EXPORT(readings)(const integration_t *m, const block_t *b, const directions_t *d,
                      const double *first, const readings_t *r) {
    int64_t longest = 0, steps = 0, station[SLOTS];
    for (int slot = 0; slot < SLOTS; slot++) {
        const int64_t *span = b->spans + 5 * slot;
        if (span[3] > steps) steps = span[3];
        if (span[4] > longest) longest = span[4];
        station[slot] = r->ranges[2 * slot];
    }
    stream_t stream = make_stream(m, b, -longest, steps);
    step_t s = {.moved = d->n ? d->moved : 0};
    vec *slopes = make_slopes(&s, m->stages), *rows = new_rows(2 * N * d->n);
    vec *dx = rows, *dx_after = rows + N * d->n, t = load(b->t), now[N], after[N];
    scatters_t by = {
        make_scatter(car_actuators_by, car_actuators_BY, d), make_scatter(car_rates_by, car_rates_BY, d),
        make_scatter(car_remember_by, car_remember_BY, d), make_scatter(car_observe_by, car_observe_BY, d),
    };
    for (int i = 0; i < N; i++) now[i] = load(first + i * SLOTS);
    for (int64_t i = 0; i < d->n; i++)
        for (int row = 0; row < N; row++)
            dx[i * N + row] = all(row < STEER ? d->first[row * d->n + i] : 0.0);
    settle(m, b, d, &by, &stream, longest, &s, now, dx);
    for (int64_t i = 0; i < d->n; i++) dx[i * N + STEER] += d->first[STEER * d->n + i];
    for (int64_t k = 0; k < steps; k++) {
        delayed(m, &stream, k, s.in);
        actuate(m, &s, now, t, k);
        march_step(m, &s, after);
        remember(m, &s, after);
        for (int64_t i = 0; i < d->n; i++) push_step(m, d, &by, &s, i, dx + i * N, dx_after + i * N);
        read_stations(m, b, d, &by, r, k, station, &s, now, after, dx, dx_after);
        vec *swap = dx;
        dx = dx_after;
        dx_after = swap;
        for (int i = 0; i < N; i++) now[i] = after[i];
        if (k % FLUSH_EVERY == 0)
            for (int64_t i = 0; i < d->n; i++)
                for (int row = car_YAW_RATE; row < N; row++)
                    dx[i * N + row] = (dx[i * N + row] + DENORMAL_GUARD) - DENORMAL_GUARD;
    }
    free_scatter(by.actuators);
    free_scatter(by.rates);
    free_scatter(by.remember);
    free_scatter(by.observe);
    free(rows);
    free(slopes);
    free(stream.rows);
}

/* Dead times (3,) [s] and their derivatives by the parameters (3, P), which are zero before. */
void EXPORT(delays)(const double *p, const double *q, double *delays, double *slopes) {
    vec out[3], j[car_delays_SLOPES + 1];
    uint8_t moved[car_PARAMETER_COUNT];
    memset(moved, 1, sizeof moved);
    car_delays_jac(0, out, j, moved, p, q, 1.0);
    for (int i = 0; i < 3; i++) delays[i] = out[i][0];
    for (int e = 0; e < car_delays_BY; e++) {
        by_t at = car_delays_by[e];
        slopes[at.output * car_PARAMETER_COUNT + at.parameter] += j[at.slope][0];
    }
}

void EXPORT(constants)(const double *p, double h, double *q) { car_constants(p, h, q); }
int64_t EXPORT(constant_count)(void) { return car_CONSTANTS; }

/* -- one car, step by step: the simulated plant ------------------------------------------------------ */

/* Every slot is the car. in: (N + 3,) state and memory, two numbers, time into the run. */
INLINE void take(step_t *s, const double *in) {
    s->moved = 0;
    for (int i = 0; i < N; i++) s->in[i] = all(in[i]);
    for (int c = 0; c < 2; c++) {
        s->in[car_ACTUATORS_COMMAND + c] = s->in[car_ACTUATORS_OLDER + c] = all(in[N + c]);
        s->in[car_ACTUATORS_SHARE + c] = all(0.0);
    }
    s->in[car_ACTUATORS_TIME] = all(in[N + 2]);
}

INLINE void move(const integration_t *m, step_t *s, double *out) {
    vec after[N];
    march_step(m, s, after);
    remember(m, s, after);
    for (int i = 0; i < N; i++) out[i] = after[i][0];
}

/* Under a servo angle and a speed to aim at; written: (N,). */
void EXPORT(follow)(const integration_t *m, const double *in, double *out) {
    step_t s;
    take(&s, in);
    car_actuators(s.in, s.out, m->p, m->q, m->h);
    move(m, &s, out);
}

/* Where the actuators get to under them; written: steering angle at the end, acceleration. */
void EXPORT(actuated)(const integration_t *m, const double *in, double *out) {
    step_t s;
    take(&s, in);
    car_actuators(s.in, s.out, m->p, m->q, m->h);
    out[0] = s.out[car_STEER_END][0];
    out[1] = s.out[car_ACCEL][0];
}

/* `substeps` steps to a steering angle at the end with an acceleration held; written: (N,). */
void EXPORT(glide)(const integration_t *m, const double *in, double *out) {
    step_t s;
    take(&s, in);
    const vec begun = s.in[STEER], way = s.in[car_ACTUATORS_COMMAND] - begun, t = s.in[car_ACTUATORS_TIME];
    s.out[car_ACCEL] = s.in[car_ACTUATORS_COMMAND + 1];
    for (int64_t i = 0; i < m->substeps; i++) {
        vec given[2 + M], linked[2 + M];
        given[0] = s.in[STEER];
        given[1] = begun + way * (double)(i + 1) / (double)m->substeps;
        for (int j = 0; j < MEMORY; j++) given[2 + j] = s.in[STATES + j];
        car_linkage(given, linked, m->p, m->q, m->h);
        s.out[car_WHEEL_START] = linked[0];
        s.out[car_WHEEL_END] = linked[1];
        s.out[car_STEER_END] = given[1];
        for (int j = 0; j < MEMORY; j++) s.out[car_MEMORY_END + j] = linked[2 + j];
        move(m, &s, out);
        for (int j = 0; j < N; j++) s.in[j] = all(out[j]);
        s.in[car_ACTUATORS_TIME] = t + (double)(i + 1) * m->h;
    }
}
