/* Histories of strain at points, through parallel elements with memory.
 * D components of stress, DI of input e (the strain, and its rate after it if the law asks for it),
 * M numbers of state and NP parameters per element; above this text stand
 *   element(e, s, p, f, sn):              stress f[D], new state sn[M]
 *   element_d(e, s, p, f, sn, fe, fs, ne, ns): and d f/d e, d f/d s, d sn/d e, d sn/d s, row-major
 *   switches(e, p, g, ge):  g[NS], whose signs choose between a law's branches, and d g/d e
 * W elements go side by side, so that the compiler can compute them with vector instructions:
 * number i of element l of a group is at [i * W + l].
 */
#define W 4
#define NP1 (NP > 0 ? NP : 1)
#define STEPS 8 /* whose derivatives are analysed at once */

/* Four harmonics side by side. */
typedef double four __attribute__((vector_size(32), aligned(8), may_alias));

static void elements(const double *restrict e, const double *restrict s, const double *restrict p,
                     double *restrict f, double *restrict sn)
{
#pragma GCC ivdep
  for (int l = 0; l < W; ++l) {
    double s1[M1], p1[NP1], f1[D], sn1[M1];
    for (int i = 0; i < M; ++i) s1[i] = s[i * W + l];
    for (int i = 0; i < NP; ++i) p1[i] = p[i * W + l];
    element(e, s1, p1, f1, sn1);
    for (int i = 0; i < D; ++i) f[i * W + l] = f1[i];
    for (int i = 0; i < M; ++i) sn[i * W + l] = sn1[i];
  }
}

typedef struct {
  double f[D * W], sn[M1 * W], fe[D * DI * W], fs[D * M1 * W], ne[M1 * DI * W], ns[M1 * M1 * W];
} derived;

static void elements_d(const double *restrict e, const double *restrict s,
                       const double *restrict p, derived *restrict to)
{
#pragma GCC ivdep
  for (int l = 0; l < W; ++l) {
    double s1[M1], p1[NP1], f1[D], sn1[M1], fe[D * DI], fs[D * M1], ne[M1 * DI], ns[M1 * M1];
    for (int i = 0; i < M; ++i) s1[i] = s[i * W + l];
    for (int i = 0; i < NP; ++i) p1[i] = p[i * W + l];
    element_d(e, s1, p1, f1, sn1, fe, fs, ne, ns);
    for (int i = 0; i < D; ++i) to->f[i * W + l] = f1[i];
    for (int i = 0; i < M; ++i) to->sn[i * W + l] = sn1[i];
    for (int i = 0; i < D * DI; ++i) to->fe[i * W + l] = fe[i];
    for (int i = 0; i < D * M; ++i) to->fs[i * W + l] = fs[i];
    for (int i = 0; i < M * DI; ++i) to->ne[i * W + l] = ne[i];
    for (int i = 0; i < M * M; ++i) to->ns[i * W + l] = ns[i];
  }
}

static int smaller(int a, int b) { return a < b ? a : b; }

/* n numbers of each of E elements, into groups of W and back; a group is filled with its last. */
static void group(int E, int n, const double *from, double *to)
{
  for (int j = 0; j < E; j += W)
    for (int i = 0; i < n; ++i)
      for (int l = 0; l < W; ++l) to[(j / W * n + i) * W + l] = from[smaller(j + l, E - 1) * n + i];
}

static void ungroup(int E, int n, const double *from, double *to)
{
  for (int j = 0; j < E; ++j)
    for (int i = 0; i < n; ++i) to[j * n + i] = from[(j / W * n + i) * W + j % W];
}

/* to[n] += the sums over the first elements of a group. */
static void add(int n, int count, const double *from, double *to)
{
  for (int i = 0; i < n; ++i)
    for (int l = 0; l < count; ++l) to[i] += from[i * W + l];
}

/* One step from states s to sn at the P inputs e; tangent (P, D, DI). Nonzero: out of memory. */
int law_step(int P, int E, const double *e, const double *s, const double *p, double *f,
             double *sn, double *tangent)
{
  const int groups = (E + W - 1) / W;
  double *sw = malloc((size_t)groups * W * (2 * M + NP + 1) * sizeof(double));
  if (!sw) return 1;
  double *snw = sw + groups * W * M, *pw = snw + groups * W * M;
  memset(f, 0, (size_t)P * D * sizeof(double));
  memset(tangent, 0, (size_t)P * D * DI * sizeof(double));
  for (int i = 0; i < P; ++i) {
    group(E, M, s + (size_t)i * E * M, sw);
    group(E, NP, p + (size_t)i * E * NP, pw);
    for (int j = 0; j < groups; ++j) {
      derived now;
      const int count = smaller(W, E - j * W);
      elements_d(e + (size_t)i * DI, sw + j * W * M, pw + j * W * NP, &now);
      memcpy(snw + j * W * M, now.sn, W * M * sizeof(double));
      add(D, count, now.f, f + i * D);
      add(D * DI, count, now.fe, tangent + (size_t)i * D * DI);
    }
    ungroup(E, M, snw, sn + (size_t)i * E * M);
  }
  free(sw);
  return 0;
}

/* Stress (P, T, D) over input (P, T, DI); the states s are carried on. Nonzero: out of memory. */
int law_history(int P, int T, int E, const double *e, double *s, const double *p, double *f)
{
  const int groups = (E + W - 1) / W;
  double *sw = malloc((size_t)groups * W * (M + NP + 1) * sizeof(double));
  if (!sw) return 1;
  double *pw = sw + groups * W * M;
  memset(f, 0, (size_t)P * T * D * sizeof(double));
  for (int i = 0; i < P; ++i) {
    group(E, M, s + (size_t)i * E * M, sw);
    group(E, NP, p + (size_t)i * E * NP, pw);
    for (int t = 0; t < T; ++t)
      for (int j = 0; j < groups; ++j) {
        const size_t at = (size_t)i * T + t;
        double fw[D * W], sn[M1 * W];
        elements(e + at * DI, sw + j * W * M, pw + j * W * NP, fw, sn);
        memcpy(sw + j * W * M, sn, W * M * sizeof(double));
        add(D, smaller(W, E - j * W), fw, f + at * D);
      }
    ungroup(E, M, sw, s + (size_t)i * E * M);
  }
  free(sw);
  return 0;
}

int law_switch_count(void) { return NS; }

/* Derivatives by the harmonics of strain: (numbers, D, B), each B fours of harmonics. */

typedef struct {
  int B, groups;
  double *s, *p; /* states and parameters of a point's elements, in groups */
  double *fs;    /* d f/d s of each element whose part is in `rest` */
  int *moved;    /* of each element: 0 if ds is zero, 1 if not, 2 if its part is in `rest` */
  four *g;       /* synthesis, (T, B) */
  four *ds;      /* d s/d X of each element, (M, D, B) */
  four *rest;    /* sum of fs ds of elements that do not move, (D, D, B) */
  four *df, *J;  /* d f/d X of some steps, (STEPS, D, D, B); (D K, D, B) */
} room;

/* d f/d X += fs d s/d X, and then if it moves d s/d X = ns d s/d X + ne d e/d X. */
static inline __attribute__((always_inline)) void
chain(int B, int moves, const double *fs, const double *ne, const double *ns,
      const four *restrict g, four *restrict ds, four *restrict df)
{
  for (int c = 0; c < D; ++c)
    for (int k = 0; k < B; ++k) {
      four old[M1];
      for (int b = 0; b < M; ++b) old[b] = ds[(b * D + c) * B + k];
      for (int a = 0; df && a < D; ++a) {
        four sum = df[(a * D + c) * B + k];
        for (int b = 0; b < M; ++b) sum += fs[a * M + b] * old[b];
        df[(a * D + c) * B + k] = sum;
      }
      for (int a = 0; moves && a < M; ++a) {
        four sum = ne[a * D + c] * g[k];
        for (int b = 0; b < M; ++b) sum += ns[a * M + b] * old[b];
        ds[(a * D + c) * B + k] = sum;
      }
    }
}

/* One element's part in the derivatives of a step. */
static void follow(int at, int l, int moving, int last, const derived *now, const four *g, four *df,
                   room *r)
{
  const int B = r->B;
  double fs[D * M1], ne[M1 * D], ns[M1 * M1];
  double *held = r->fs + at * D * M1;
  four *ds = r->ds + (size_t)at * M1 * D * B;
  for (int i = 0; i < D * M; ++i) fs[i] = last ? now->fs[i * W + l] : 0.0;
  if (r->moved[at] == 2) {
    if (!moving && !memcmp(fs, held, D * M * sizeof(double))) return;
    for (int i = 0; i < D * M; ++i) held[i] = -held[i];
    chain(B, 0, held, NULL, NULL, NULL, ds, r->rest);
    r->moved[at] = 1;
  }
  if (!moving) {
    if (!last || !r->moved[at]) return;
    memcpy(held, fs, D * M * sizeof(double));
    chain(B, 0, fs, NULL, NULL, NULL, ds, r->rest);
    r->moved[at] = 2;
    return;
  }
  for (int i = 0; i < M * D; ++i) ne[i] = now->ne[i * W + l];
  for (int i = 0; i < M * M; ++i) ns[i] = now->ns[i * W + l];
  if (last) chain(B, 1, fs, ne, ns, g, ds, df);
  else chain(B, 1, NULL, ne, ns, g, ds, NULL);
  r->moved[at] = 1;
}

static int moves(int l, const double *s, const double *sn)
{
  for (int i = 0; i < M; ++i)
    if (s[i * W + l] != sn[i * W + l]) return 1;
  return 0;
}

/* One step of a point: stress f[D], and its derivative df, or none. */
static void advance(int E, const double *e, const four *g, int last, int jacobian, double *f,
                    four *df, room *r)
{
  double fe[D * D] = {0.0};
  const int B = r->B;
  if (df) memset(df, 0, D * D * B * sizeof(four));
  for (int j = 0; j < r->groups; ++j) {
    derived now;
    double *s = r->s + j * W * M;
    const int count = smaller(W, E - j * W);
    int any = 0, moving[W];
    if (last && jacobian) elements_d(e, s, r->p + j * W * NP, &now);
    else elements(e, s, r->p + j * W * NP, now.f, now.sn);
    for (int l = 0; l < count; ++l) any |= moving[l] = moves(l, s, now.sn);
    if (jacobian && any && !last) elements_d(e, s, r->p + j * W * NP, &now);
    /* An element that does not move carries its derivative on as it is. */
    for (int l = 0; M && jacobian && (any || last) && l < count; ++l)
      follow(j * W + l, l, moving[l], last, &now, g, df, r);
    memcpy(s, now.sn, W * M * sizeof(double));
    if (!last) continue;
    add(D, count, now.f, f);
    if (jacobian) add(D * D, count, now.fe, fe);
  }
  if (!last || !jacobian) return;
  for (int a = 0; a < D; ++a)
    for (int c = 0; c < D; ++c)
      for (int k = 0; k < B; ++k)
        df[(a * D + c) * B + k] += r->rest[(a * D + c) * B + k] + fe[a * D + c] * g[k];
}

/* J += analysis of `count` steps' derivatives. */
static inline __attribute__((always_inline)) void
analyse_steps(int count, int K, int T, int B, const double *analysis, const four *restrict df,
              four *restrict J)
{
  const int columns = D * B;
  for (int c = 0; c < D; ++c)
    for (int q = 0; q < columns; ++q) {
      four now[STEPS];
      for (int t = 0; t < count; ++t) now[t] = df[(t * D + c) * columns + q];
      for (int k = 0; k < K; ++k) {
        four sum = J[(c * K + k) * columns + q];
        for (int t = 0; t < count; ++t) sum += analysis[(size_t)k * T + t] * now[t];
        J[(c * K + k) * columns + q] = sum;
      }
    }
}

/* One point through its cycles; see law_harmonic. */
static void run_point(int E, int K, int T, int cycles, const double *analysis, const double *e,
                      double *f, double *F, double *J, double *begun, room *r)
{
  const int B = r->B, columns = D * B;
  memset(r->ds, 0, (size_t)r->groups * W * M1 * columns * sizeof(four));
  memset(r->rest, 0, (size_t)D * columns * sizeof(four));
  memset(r->moved, 0, (size_t)r->groups * W * sizeof(int));
  memset(r->J, 0, (size_t)D * K * columns * sizeof(four));
  memset(f, 0, (size_t)T * D * sizeof(double));
  memset(F, 0, (size_t)D * K * sizeof(double));
  for (int cycle = 0; cycle < cycles; ++cycle) {
    const int last = cycle == cycles - 1;
    if (last) ungroup(E, M, r->s, begun);
    for (int t = 0; t < T; ++t) {
      const int step = t % STEPS;
      four *df = last && J ? r->df + (size_t)step * D * columns : NULL;
      advance(E, e + t * D, r->g + t * B, last, J != NULL, f + t * D, df, r);
      if (!df) continue;
      const double *from = analysis + t - step;
      if (step == STEPS - 1) analyse_steps(STEPS, K, T, B, from, r->df, r->J);
      else if (t == T - 1) analyse_steps(step + 1, K, T, B, from, r->df, r->J);
    }
  }
  for (int c = 0; c < D; ++c)
    for (int k = 0; k < K; ++k)
      for (int t = 0; t < T; ++t) F[c * K + k] += analysis[(size_t)k * T + t] * f[t * D + c];
  if (!J) return;
  for (int i = 0; i < D * K * D; ++i)
    memcpy(J + (size_t)i * K, r->J + (size_t)i * B, K * sizeof(double));
}

/* For laws without rate. Harmonics F (P, D, K) of the last cycle's stress by those of strain X (P, D, K), and their
 * derivative J (P, D, K, D, K), or none; synthesis (T, K), analysis (K, T). Strain e and stress f
 * are (P, T, D); begun (P, E, M) are the states at the start of the last cycle, s those at its end.
 * Nonzero: out of memory.
 */
int law_harmonic(int P, int E, int K, int T, int cycles, const double *X, const double *synthesis,
                 const double *analysis, const double *p, double *s, double *begun, double *e,
                 double *f, double *F, double *J)
{
  const int B = (K + 3) / 4, groups = (E + W - 1) / W, n = groups * W;
  const size_t columns = (size_t)D * B;
  room r = {.B = B, .groups = groups};
  r.s = malloc((size_t)n * (M + NP + D * M1) * sizeof(double));
  r.moved = malloc((size_t)n * sizeof(int));
  r.g = calloc((size_t)T * B + (n * M1 + D + STEPS * D + D * K) * columns, sizeof(four));
  const int failed = !r.s || !r.moved || !r.g;
  if (!failed) {
    r.p = r.s + n * M;
    r.fs = r.p + n * NP;
    r.ds = r.g + (size_t)T * B;
    r.rest = r.ds + n * M1 * columns;
    r.df = r.rest + D * columns;
    r.J = r.df + STEPS * D * columns;
    for (int t = 0; t < T; ++t) memcpy(r.g + t * B, synthesis + t * K, K * sizeof(double));
  }
  for (int i = 0; i < P && !failed; ++i) {
    double *ei = e + (size_t)i * T * D;
    for (int t = 0; t < T; ++t)
      for (int c = 0; c < D; ++c) {
        double sum = 0.0;
        for (int k = 0; k < K; ++k) sum += synthesis[t * K + k] * X[(i * D + c) * K + k];
        ei[t * D + c] = sum;
      }
    const size_t at = (size_t)i * E;
    group(E, M, s + at * M, r.s);
    group(E, NP, p + at * NP, r.p);
    run_point(E, K, T, cycles, analysis, ei, f + (size_t)i * T * D, F + (size_t)i * D * K,
              J ? J + (size_t)i * D * K * D * K : NULL, begun + at * M, &r);
    ungroup(E, M, r.s, s + at * M);
  }
  free(r.s); free(r.moved); free(r.g);
  return failed;
}

/* Derivatives of every step of a history e (P, T, DI) from the states s (P, E, M), which are carried
 * on: fe (P, T, D, DI) of the stress by the input; of each element fs (P, T, E, D, M) by the state
 * before the step, ne (P, T, E, M, DI) and ns (P, T, E, M, M) of the state after it.
 */
int law_slopes(int P, int T, int E, const double *e, double *s, const double *p, double *fe,
               double *fs, double *ne, double *ns)
{
  memset(fe, 0, (size_t)P * T * D * DI * sizeof(double));
  for (int i = 0; i < P; ++i)
    for (int t = 0; t < T; ++t) {
      const size_t at = (size_t)i * T + t;
      for (int j = 0; j < E; ++j) {
        double f[D], sn[M1], d1[D * DI], d2[D * M1], d3[M1 * DI], d4[M1 * M1];
        double *state = s + ((size_t)i * E + j) * M;
        const size_t one = at * E + j;
        element_d(e + at * DI, state, p + ((size_t)i * E + j) * NP, f, sn, d1, d2, d3, d4);
        for (int n = 0; n < D * DI; ++n) fe[at * D * DI + n] += d1[n];
        memcpy(fs + one * D * M, d2, D * M * sizeof(double));
        memcpy(ne + one * M * DI, d3, M * DI * sizeof(double));
        memcpy(ns + one * M * M, d4, M * M * sizeof(double));
        memcpy(state, sn, M * sizeof(double));
      }
    }
  return 0;
}
