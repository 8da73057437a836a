/* Rows of eight doubles and elementary functions on them, the same bits from every compiler.
 *
 * Only additions, multiplications, divisions, square roots and operations on bits, all exactly
 * rounded; nothing may be contracted to FMA (-ffp-contract=off). Good to a few units in the last
 * place for angles up to 1e5 rad. Coefficients: Cephes library (S. Moshier).
 */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { SLOTS = 8 };
typedef double vec __attribute__((vector_size(64)));
typedef double vec_near __attribute__((vector_size(64), aligned(8)));
typedef int64_t bits __attribute__((vector_size(64)));
#define INLINE static inline __attribute__((always_inline))

INLINE vec load(const double *from) { return *(const vec_near *)from; }
INLINE void store(double *to, vec row) { *(vec_near *)to = row; }
INLINE vec all(double x) { return (vec){x, x, x, x, x, x, x, x}; }
INLINE vec pick(bits c, vec a, vec b) { return (vec)(((bits)a & c) | ((bits)b & ~c)); }
INLINE vec select8(vec c, vec a, vec b) { return pick(c > 0.0, a, b); }
INLINE vec min8(vec a, vec b) { return pick(a < b, a, b); }
INLINE vec max8(vec a, vec b) { return pick(a > b, a, b); }
INLINE vec abs8(vec x) { return (vec)((bits)x & INT64_MAX); }
INLINE int all_above(vec x, double bound) {
    bits c = x > bound;
    return (c[0] & c[1] & c[2] & c[3] & c[4] & c[5] & c[6] & c[7]) != 0;
}
INLINE vec sqrt8(vec x) {
    vec y;
    for (int i = 0; i < SLOTS; i++) y[i] = __builtin_sqrt(x[i]);
    return y;
}

/* Adding this leaves the nearest integer in the lowest bits. */
#define NEAREST 6755399441055744.0
#define NEAREST_BITS 0x4338000000000000

INLINE vec quarters(vec x, bits *quarter) {
    vec n = x * 0.63661977236758134308 + NEAREST;
    *quarter = (bits)n;
    n = n - NEAREST;
    return ((x - n * 1.57079625129699707031) - n * 7.54978941586159635336e-8)
        - n * 5.39030285815811905290e-15;
}
INLINE vec sin_near(vec r) {
    vec z = r * r, p = z * 1.58962301576546568060e-10 - 2.50507477628578072866e-8;
    p = p * z + 2.75573136213857245213e-6;
    p = p * z - 1.98412698295895385996e-4;
    p = p * z + 8.33333333332211858878e-3;
    p = p * z - 1.66666666666666307295e-1;
    return r + r * z * p;
}
INLINE vec cos_near(vec r) {
    vec z = r * r, p = z * -1.13585365213876817300e-11 + 2.08757008419747316778e-9;
    p = p * z - 2.75573141792967388112e-7;
    p = p * z + 2.48015872888517045348e-5;
    p = p * z - 1.38888888888730564116e-3;
    p = p * z + 4.16666666666665929218e-2;
    return 1.0 - 0.5 * z + z * z * p;
}
INLINE vec sin_from(vec x, int64_t ahead) {
    bits quarter;
    vec r = quarters(x, &quarter);
    quarter += ahead;
    vec size = pick(-(quarter & 1), cos_near(r), sin_near(r));
    return (vec)((bits)size ^ ((quarter & 2) << 62));
}
INLINE vec sin8(vec x) { return sin_from(x, 0); }
INLINE vec cos8(vec x) { return sin_from(x, 1); }
INLINE vec tan8(vec x) {
    bits quarter;
    vec r = quarters(x, &quarter), s = sin_near(r), c = cos_near(r);
    bits odd = -(quarter & 1);
    return pick(odd, -c, s) / pick(odd, s, c);
}
INLINE vec atan8(vec x) {
    vec a = abs8(x);
    bits steep = a > 2.41421356237309504880, middle = a > 0.66;
    vec base = pick(steep, all(1.57079632679489661923), pick(middle, all(0.78539816339744830962), all(0.0)));
    vec u = pick(steep, all(-1.0), pick(middle, a - 1.0, a));
    u = u / pick(steep, a, pick(middle, a + 1.0, all(1.0)));
    vec z = u * u, p = z * -8.750608600031904122785e-1 - 1.615753718733365076637e1;
    p = p * z - 7.500855792314704667340e1;
    p = p * z - 1.228866684490136173410e2;
    p = p * z - 6.485021904942025371773e1;
    vec q = z + 2.485846490142306297962e1;
    q = q * z + 1.650270098316988542046e2;
    q = q * z + 4.328810604912902668951e2;
    q = q * z + 4.853903996359136964868e2;
    q = q * z + 1.945506571482613964425e2;
    vec size = base + (u * (z * p / q) + u);
    return (vec)((bits)size | ((bits)x & INT64_MIN));
}
INLINE vec exp8(vec x) {
    vec n = x * 1.44269504088896340736 + NEAREST;
    bits power = (bits)n - NEAREST_BITS;
    n = n - NEAREST;
    vec r = (x - n * 6.93145751953125e-1) - n * 1.42860682030941723212e-6, z = r * r;
    vec p = z * 1.26177193074810590878e-4 + 3.02994407707441961300e-2;
    p = r * (p * z + 9.99999999999999999910e-1);
    vec q = z * 3.00198505138664455042e-6 + 2.52448340349684104192e-3;
    q = q * z + 2.27265548208155028766e-1;
    q = q * z + 2.0;
    vec y = (1.0 + 2.0 * (p / (q - p))) * (vec)((power + 1023) << 52);
    y = pick(x < -708.0, all(0.0), y);
    return pick(x > 709.0, all(__builtin_inf()), y);
}
INLINE vec tanh8(vec x) {
    vec a = abs8(x), z = x * x;
    vec far = 1.0 - 2.0 / (exp8(2.0 * a) + 1.0);
    vec p = z * -9.64399179425052238628e-1 - 9.92877231001918586564e1;
    p = p * z - 1.61468768441708447952e3;
    vec q = z + 1.12811678491632931402e2;
    q = q * z + 2.23548839060100448583e3;
    q = q * z + 4.84406305325125486048e3;
    vec near = x + x * z * (p / q);
    return pick(a > 0.625, (vec)((bits)far | ((bits)x & INT64_MIN)), near);
}

/* A derivative by a parameter: its place among a piece's derivatives. */
typedef struct {
    int32_t slope, output, parameter;
} by_t;
