/* Symmetric sparse matrices in dense blocks of B x B, of which each row holds the upper half, the
 * diagonal block first, times eight columns at once: arrays of n x B rows of eight numbers.
 */
#define INLINE static inline __attribute__((always_inline))
#define EACH(i, n) _Pragma("GCC unroll 8") for (int i = 0; i < n; ++i)

/* Eight numbers in as many registers as they take: GCC keeps wider vectors in memory. */
#if defined(__AVX512F__)
#define PARTS 1
#elif defined(__AVX__)
#define PARTS 2
#else
#define PARTS 4
#endif
typedef double part __attribute__((vector_size(64 / PARTS), aligned(8), may_alias));
typedef struct __attribute__((may_alias)) { part parts[PARTS]; } eight;

/* out += a x */
INLINE void plus(double a, const eight *x, eight *out) {
  EACH(p, PARTS) out->parts[p] += a * x->parts[p];
}

/* out += a x */
INLINE void add(const int B, const double *a, const eight *x, eight *out) {
  EACH(r, B) EACH(c, B) plus(a[r * B + c], x + c, out + r);
}

/* out += a^T x */
INLINE void add_transposed(const int B, const double *a, const eight *x, eight *out) {
  EACH(c, B) {
    eight sum = out[c];
    EACH(r, B) plus(a[r * B + c], x + r, &sum);
    out[c] = sum;
  }
}

/* y += A x */
INLINE void multiply(const int B, int n, const long *at, const int *column, const double *a,
                     const eight *x, eight *y) {
  for (long i = 0; i < n; ++i) {
    eight own[6] = {}, from[6];
    EACH(r, B) from[r] = x[i * B + r];
    add(B, a + at[i] * B * B, from, own);
    for (long k = at[i] + 1; k < at[i + 1]; ++k) {
      add(B, a + k * B * B, x + (long)column[k] * B, own);
      add_transposed(B, a + k * B * B, from, y + (long)column[k] * B);
    }
    EACH(r, B) plus(1, own + r, y + i * B + r);
  }
}

/* Symmetric Gauss-Seidel from zero for b: z, and the residual r = b - A z, which is zero at first.
 * The diagonal blocks are A's and beyond them a diagonal, extra; inverse holds their inverses.
 */
INLINE void smooth(const int B, int n, const long *at, const int *column, const double *a,
                   const double *inverse, const double *extra, const eight *b, eight *z,
                   eight *r) {
  for (long i = 0; i < n; ++i) { /* r collects what the rows above take from this one */
    eight own[6], found[6] = {};
    EACH(s, B) own[s] = b[i * B + s], plus(-1, r + i * B + s, own + s);
    add(B, inverse + i * B * B, own, found);
    for (long k = at[i] + 1; k < at[i + 1]; ++k)
      add_transposed(B, a + k * B * B, found, r + (long)column[k] * B);
    EACH(s, B) z[i * B + s] = found[s], r[i * B + s] = (eight){};
  }
  for (long i = n - 1; i >= 0; --i) {
    eight sum[6] = {}, change[6] = {};
    for (long k = at[i] + 1; k < at[i + 1]; ++k)
      add(B, a + k * B * B, z + (long)column[k] * B, sum);
    add(B, inverse + i * B * B, sum, change);
    for (long k = at[i] + 1; k < at[i + 1]; ++k)
      add_transposed(B, a + k * B * B, change, r + (long)column[k] * B);
    EACH(s, B) plus(-1, change + s, z + i * B + s);
    EACH(s, B) plus(extra[i * B + s], z + i * B + s, r + i * B + s);
  }
}

#define SIZES(CALL)  \
  switch (size) {    \
    CALL(1) CALL(2) CALL(3) CALL(4) CALL(5) CALL(6) \
  }                  \
  return 1;

int blocks_multiply(int size, int n, const long *at, const int *column, const double *a,
                    const double *x, double *y) {
#define MULTIPLY(B) \
  case B: multiply(B, n, at, column, a, (const eight *)x, (eight *)y); return 0;
  SIZES(MULTIPLY)
}

int blocks_smooth(int size, int n, const long *at, const int *column, const double *a,
                  const double *inverse, const double *extra, const double *b, double *z,
                  double *r) {
#define SMOOTH(B)                                                                               \
  case B:                                                                                       \
    smooth(B, n, at, column, a, inverse, extra, (const eight *)b, (eight *)z, (eight *)r);      \
    return 0;
  SIZES(SMOOTH)
}
