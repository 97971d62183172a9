/* Harmonics of stress of laws with memory. A slider turns where its strain does, and starts to slide
 * somewhere between two samples: sampled stress has harmonics that are off by the square of the step,
 * and as rough as the samples pass over these instants. Here the states go from sample to sample, with
 * a step at each reversal of the strain between, and from every state Gauss's rule integrates the
 * stress up to the next, in pieces that end where a switch of an element changes its sign.
 *
 * Derivatives by the harmonics of strain: (numbers, D, B), each B fours of harmonics. They have what a
 * reversal moves by; what moves the ends of a piece changes nothing, as the stress has no jump there.
 */
#define STEPS 8 /* whose derivatives are analysed at once */
#define JUST 1e-3 /* share of an interval that counts as just after its start */
#define HALVINGS 16 /* of an interval where a slider may stop: the stress feels its square */
#define SAME 1e-12 /* phases closer than that are one */
#define NOTABLE 0.1 /* a strain's rate over that of the largest below which it has no reversals */

/* Four harmonics side by side. */
typedef double four __attribute__((vector_size(32), aligned(8), may_alias));

/* An instant: a step of the states, or just an end of a piece. At a reversal of strain it moves with
 * that component's harmonics, at any other step `component` is -1.
 */
typedef struct {
  double at;
  int step, component;
} instant;

typedef struct {
  int n, room, failed;
  instant *of;
} instants;

/* Phases of a cycle in their order: states go on where `step`, elsewhere there is stress. */
typedef struct {
  int n, room, stresses;
  instant *at;
  double *e, *rates;    /* strain and its rate, (n, D) */
  double *columns, *analysis; /* (stresses, K), (K, stresses) */
  four *g, *shift;      /* harmonics, and d phase / d harmonics of a reversal, (n, B) */
} grid;

typedef struct {
  int B, groups;
  double *s, *p; /* states and parameters of a point's elements, in groups */
  double *fs;    /* d f/d s of each element whose part is in `rest` */
  int *moved;    /* of each element: 0 if ds is zero, 1 if not, 2 if its part is in `rest` */
  four *ds;      /* d s/d X of each element, (M, D, B) */
  four *rest;    /* sum of fs ds of elements that do not move, (D, D, B) */
  four *df, *J;  /* d f/d X of some phases, (STEPS, D, D, B); (D K, D, B) */
} room;

/* to (D, D, B) += fs d s/d X. */
static inline __attribute__((always_inline)) void
add_states(int B, const double *fs, const four *restrict ds, four *restrict to)
{
  for (int a = 0; a < D; ++a)
    for (int b = 0; b < M; ++b)
      for (int q = 0; q < D * B; ++q) to[a * D * B + q] += fs[a * M + b] * ds[b * D * B + q];
}

/* Take an element's part out of `rest`. */
static void release(int at, room *r)
{
  double *held = r->fs + at * D * M;
  for (int i = 0; i < D * M; ++i) held[i] = -held[i];
  add_states(r->B, held, r->ds + (size_t)at * M * D * r->B, r->rest);
  r->moved[at] = 1;
}

static int moves(int l, const double *s, const double *sn)
{
  for (int i = 0; i < M; ++i)
    if (s[i * W + l] != sn[i * W + l]) return 1;
  return 0;
}

/* Stress f at a phase between two steps, and its derivative df, or none. */
static void stress_at(int E, const double *e, const four *g, double *f, four *df, room *r)
{
  double fe[D * D] = {0.0};
  const int B = r->B;
  if (df) memset(df, 0, D * D * B * sizeof(four));
  for (int j = 0; j < r->groups; ++j) {
    derived now;
    const double *s = r->s + j * W * M;
    const int count = smaller(W, E - j * W);
    if (df) elements_d(e, s, r->p + j * W * NP, &now);
    else elements(e, s, r->p + j * W * NP, now.f, now.sn);
    add(D, count, now.f, f);
    if (!df) continue;
    add(D * D, count, now.fe, fe);
    for (int l = 0; l < count; ++l) {
      const int at = j * W + l;
      double fs[D * M], *held = r->fs + at * D * M;
      const four *ds = r->ds + (size_t)at * M * D * B;
      if (!r->moved[at]) continue;
      for (int i = 0; i < D * M; ++i) fs[i] = now.fs[i * W + l];
      if (r->moved[at] == 2) {
        if (!memcmp(fs, held, sizeof fs)) continue;
        release(at, r);
      }
      /* What an element adds that does not move is the same at the next phases. */
      const int moving = moves(l, s, now.sn);
      add_states(B, fs, ds, moving ? df : r->rest);
      if (moving) continue;
      memcpy(held, fs, sizeof fs);
      r->moved[at] = 2;
    }
  }
  if (!df) return;
  for (int a = 0; a < D; ++a)
    for (int c = 0; c < D; ++c)
      for (int k = 0; k < B; ++k)
        df[(a * D + c) * B + k] += r->rest[(a * D + c) * B + k] + fe[a * D + c] * g[k];
}

/* States go to the strain e, and their derivatives d s/d X = ns d s/d X + ne d e/d X with them. */
static void step_to(int E, const instant *step, const double *e, const double *rates, const four *g,
                    const four *shift, int jacobian, room *r)
{
  const int B = r->B;
  for (int j = 0; j < r->groups; ++j) {
    derived now;
    double *s = r->s + j * W * M, fw[D * W];
    const int count = smaller(W, E - j * W);
    int any = 0, moving[W];
    elements(e, s, r->p + j * W * NP, fw, now.sn);
    for (int l = 0; l < count; ++l) any |= moving[l] = moves(l, s, now.sn);
    if (jacobian && any) elements_d(e, s, r->p + j * W * NP, &now);
    for (int l = 0; jacobian && any && l < count; ++l) {
      if (!moving[l]) continue;
      const int at = j * W + l;
      four *restrict ds = r->ds + (size_t)at * M * D * B;
      if (r->moved[at] == 2) release(at, r);
      for (int c = 0; c < D; ++c)
        for (int k = 0; k < B; ++k) {
          four old[M];
          for (int b = 0; b < M; ++b) old[b] = ds[(b * D + c) * B + k];
          for (int a = 0; a < M; ++a) {
            four sum = now.ne[(a * D + c) * W + l] * g[k];
            for (int b = 0; b < M; ++b) sum += now.ns[(a * M + b) * W + l] * old[b];
            for (int b = 0; c == step->component && b < D; ++b)
              sum += now.ne[(a * D + b) * W + l] * rates[b] * shift[k];
            ds[(a * D + c) * B + k] = sum;
          }
        }
      r->moved[at] = 1;
    }
    memcpy(s, now.sn, W * M * sizeof(double));
  }
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

/* One point through its cycles: all but the last on the first grid, the last on the second. */
static void run_point(int E, int K, int cycles, const grid *grids, double *F, double *J,
                      double *begun, room *r)
{
  const int B = r->B, columns = D * B;
  memset(r->ds, 0, (size_t)r->groups * W * M * columns * sizeof(four));
  memset(r->rest, 0, (size_t)D * columns * sizeof(four));
  memset(r->moved, 0, (size_t)r->groups * W * sizeof(int));
  memset(r->J, 0, (size_t)D * K * columns * sizeof(four));
  memset(F, 0, (size_t)D * K * sizeof(double));
  for (int cycle = 0; cycle < cycles; ++cycle) {
    const grid *on = grids + (cycle == cycles - 1);
    const int last = on->stresses - 1;
    if (cycle == cycles - 1) ungroup(E, M, r->s, begun);
    for (int i = 0, t = 0; i < on->n; ++i) {
      const double *e = on->e + i * D;
      const four *g = on->g + (size_t)i * B;
      if (on->at[i].step) {
        step_to(E, on->at + i, e, on->rates + i * D, g, on->shift + (size_t)i * B, J != NULL, r);
        continue;
      }
      const int step = t % STEPS;
      double f[D] = {0.0};
      stress_at(E, e, g, f, J ? r->df + (size_t)step * D * columns : NULL, r);
      for (int c = 0; c < D; ++c)
        for (int k = 0; k < K; ++k) F[c * K + k] += on->columns[(size_t)t * K + k] * f[c];
      if (J && (step == STEPS - 1 || t == last))
        analyse_steps(step + 1, K, on->stresses, B, on->analysis + t - step, r->df, r->J);
      ++t;
    }
  }
  if (!J) return;
  for (int i = 0; i < D * K * D; ++i)
    memcpy(J + (size_t)i * K, r->J + (size_t)i * B, K * sizeof(double));
}

/* -- instants ---------------------------------------------------------------------------------- */

static void note(instants *all, double at, int step, int component)
{
  if (all->n == all->room) {
    const int more = 2 * all->room + 64;
    instant *of = realloc(all->of, more * sizeof(instant));
    if (!of) {
      all->failed = 1;
      return;
    }
    all->of = of;
    all->room = more;
  }
  all->of[all->n++] = (instant){at, step, component};
}

static int earlier(const void *a, const void *b)
{
  const double x = ((const instant *)a)->at, y = ((const instant *)b)->at;
  return (x > y) - (x < y);
}

/* In order; those that are no steps keep `least` from all others. */
static void sort_instants(instants *all, double least)
{
  int n = 0;
  qsort(all->of, all->n, sizeof(instant), earlier);
  for (int i = 0; i < all->n; ++i) {
    const instant now = all->of[i];
    if (n && now.step && !all->of[n - 1].step && now.at - all->of[n - 1].at < least) --n;
    const double gap = n ? now.at - all->of[n - 1].at : TURN;
    if (gap > (now.step ? SAME : least)) all->of[n++] = now;
  }
  all->n = n;
}

static double size(const double *X, int K)
{
  double sum = 0.0;
  for (int k = 1; k < K; ++k) sum += X[k] * X[k];
  return sqrt(sum);
}

/* Where the rates of strain change their signs, sampled at T phases. */
static void reversals(const watched *w, int T, const double *synthesis, instants *to)
{
  double before[D], now[D], largest = 0.0;
  for (int c = 0; c < D; ++c) largest = fmax(largest, size(w->Zd + c * w->K, w->K));
  combine(w->K, w->Zd, synthesis, before);
  for (int t = 1; t <= T; ++t) {
    combine(w->K, w->Zd, synthesis + (size_t)(t % T) * w->K, now);
    for (int c = 0; c < D; ++c) {
      if ((now[c] >= 0) == (before[c] >= 0)) continue;
      if (size(w->Zd + c * w->K, w->K) < NOTABLE * largest) continue;
      double low = TURN * (t - 1) / T, high = TURN * t / T;
      for (int i = 0; i < BISECTIONS; ++i) {
        const double middle = 0.5 * (low + high);
        double rate = 0.0;
        harmonics_at(middle, w->K, w->b);
        for (int k = 0; k < w->K; ++k) rate += w->Zd[c * w->K + k] * w->b[k];
        if ((rate >= 0) == (before[c] >= 0)) low = middle;
        else high = middle;
      }
      note(to, 0.5 * (low + high), 1, c);
    }
    memcpy(before, now, sizeof before);
  }
}

/* Slope of the watched switch at a phase, with the state of the way there. */
static double slope_on_the_way(const watched *w, const double *e, const double *de)
{
  double f[D], sn[M], slope;
  watched on = *w;
  element(e, w->s, w->p, f, sn);
  on.s = sn;
  look_at(&on, e, de, &slope);
  return slope;
}

static double slope_at(const watched *w, double phase)
{
  double e[D], de[D];
  harmonics_at(phase, w->K, w->b);
  combine(w->K, w->Z, w->b, e);
  combine(w->K, w->Zd, w->b, de);
  return slope_on_the_way(w, e, de);
}

/* Strain and its rate, (2, D), at a phase: the same for all elements. */
static void strain_at(const watched *w, double phase, double *to)
{
  harmonics_at(phase, w->K, w->b);
  combine(w->K, w->Z, w->b, to);
  combine(w->K, w->Zd, w->b, to + D);
}

/* Ends of pieces of one element between low and high, where it starts from the state w->s. A slider
 * stops where the slope of its switch, which sliding keeps at zero, changes its sign: under a pressure
 * that varies that is no reversal of the strain. `at`, (3, 2, D), is strain and rate just after low,
 * at high and just before it.
 */
static void between(watched *w, double low, double high, const double *at, instants *to)
{
  double f[D], sn[M], start, end, found[2];
  const double just = low + JUST * (high - low);
  int moves = 0;
  watched moved = *w;
  moved.s = sn;
  if (D > 1) { /* of one component the reversals are steps */
    element(at, w->s, w->p, f, sn);
    moves = memcmp(sn, w->s, M * sizeof(double)) != 0;
  }
  for (w->number = 0; w->number < NS; ++w->number) {
    const double g = look_at(w, at, at + D, &start), after = look_at(w, at + 2 * D, at + 3 * D, &end);
    if ((g >= 0) != (after >= 0)) note(to, crossing(w, just, high, g), 0, -1);
    else {
      const int n = hidden(w, just, high, g, start, after, end, found);
      for (int i = 0; i < n; ++i) note(to, found[i], 0, -1);
    }
    if (!moves) continue;
    double a = just, b = high - JUST * (high - low);
    moved.number = w->number;
    look_at(&moved, at, at + D, &start);
    if (start * slope_on_the_way(w, at + 4 * D, at + 5 * D) >= 0) continue;
    for (int i = 0; i < HALVINGS; ++i) {
      const double middle = 0.5 * (a + b);
      if (slope_at(w, middle) * start > 0) a = middle;
      else b = middle;
    }
    note(to, a, 0, -1);
  }
}

/* Ends of pieces of all elements in the last of the cycles; r->s goes through them. Nonzero: out of memory.
 */
static int element_instants(watched *w, int E, int cycles, const double *p, const instants *steps,
                            room *r, instants *to)
{
  double *at = malloc((size_t)steps->n * 6 * D * sizeof(double));
  if (!at) return 1;
  for (int i = 0; i < steps->n; ++i) {
    const double high = steps->of[i].at, low = i ? steps->of[i - 1].at : high;
    strain_at(w, low + JUST * (high - low), at + i * 6 * D);
    strain_at(w, high, at + i * 6 * D + 2 * D);
    strain_at(w, high - JUST * (high - low), at + i * 6 * D + 4 * D);
  }
  for (int cycle = 0; cycle < cycles; ++cycle)
    for (int i = 0; i < steps->n; ++i) {
      const double *e = at + i * 6 * D;
      for (int j = 0; i && cycle == cycles - 1 && j < E; ++j) {
        double now[M];
        for (int m = 0; m < M; ++m) now[m] = r->s[(j / W * M + m) * W + j % W];
        w->s = now;
        w->p = p + (size_t)j * NP;
        between(w, steps->of[i - 1].at, steps->of[i].at, e, to);
      }
      for (int j = 0; j < r->groups; ++j) {
        double f[D * W], sn[M * W];
        elements(e + 2 * D, r->s + j * W * M, r->p + j * W * NP, f, sn);
        memcpy(r->s + j * W * M, sn, sizeof sn);
      }
    }
  free(at);
  return 0;
}

/* Add a phase to a grid that has room for it. */
static void add_phase(const watched *w, instant now, double weight, int B, grid *to)
{
  const int i = to->n++, K = w->K;
  double *rates = to->rates + (size_t)i * D;
  to->at[i] = now;
  harmonics_at(now.at, K, w->b);
  combine(K, w->Z, w->b, to->e + (size_t)i * D);
  combine(K, w->Zd, w->b, rates);
  four *g = to->g + (size_t)i * B, *shift = to->shift + (size_t)i * B;
  memset(g, 0, B * sizeof(four));
  memset(shift, 0, B * sizeof(four));
  memcpy(g, w->b, K * sizeof(double));
  if (!now.step) {
    double *column = to->columns + (size_t)to->stresses++ * K;
    const double share = 2.0 * weight / TURN;
    for (int k = 0; k < K; ++k) column[k] = (k ? share : 0.5 * share) * w->b[k];
  } else if (now.component >= 0) {
    /* The rate, sum Zd b, is zero: d phase = -d rate / second rate. Of the strain's harmonics Z and
     * those of its rate Zd = rotation Z, per phase of a response, d rate is b' dZ. */
    double second = 0.0, *to_phase = (double *)shift;
    const double *Zd = w->Zd + now.component * K;
    for (int k = 1; k < K; k += 2) {
      const double h = 0.5 * (k + 1);
      second += h * (Zd[k + 1] * w->b[k] - Zd[k] * w->b[k + 1]);
    }
    for (int k = 1; k < K; k += 2) {
      const double h = 0.5 * (k + 1);
      to_phase[k] = h * w->b[k + 1] / second;
      to_phase[k + 1] = -h * w->b[k] / second;
    }
  }
}

/* The grid of a cycle; pieces of a length have Gauss's rules, from 0 to 1, of 1 to `order` nodes. */
static int make_grid(const watched *w, const instants *ends, int stresses, int order,
                     const double *rules, int B, grid *to)
{
  const int most = ends->n * (order + 1), K = w->K;
  if (most > to->room) {
    free(to->at); free(to->e); free(to->g);
    to->room = 2 * most;
    to->at = malloc(to->room * sizeof(instant));
    to->e = malloc((size_t)to->room * 2 * (D + K) * sizeof(double));
    to->g = malloc((size_t)to->room * 2 * B * sizeof(four));
  }
  if (!to->at || !to->e || !to->g) return 1;
  to->rates = to->e + (size_t)to->room * D;
  to->columns = to->rates + (size_t)to->room * D;
  to->analysis = to->columns + (size_t)to->room * K;
  to->shift = to->g + (size_t)to->room * B;
  to->n = to->stresses = 0;
  for (int i = 0; i < ends->n; ++i) {
    for (int q = 0, n = 0; i && stresses && q <= n; ++q) {
      const double low = ends->of[i - 1].at, length = ends->of[i].at - low;
      const double turn = 0.5 * (K - 1) * length; /* of the highest harmonic */
      n = smaller(order, turn < 0.3 ? 2 : turn < 0.5 ? 3 : turn < 1 ? 4 : order);
      const double *rule = rules + (n - 1) * n;
      if (q == n) break;
      add_phase(w, (instant){low + length * rule[q], 0, -1}, length * rule[n + q], B, to);
    }
    if (ends->of[i].step) add_phase(w, ends->of[i], 0.0, B, to);
  }
  for (int t = 0; t < to->stresses; ++t)
    for (int k = 0; k < K; ++k)
      to->analysis[(size_t)k * to->stresses + t] = to->columns[(size_t)t * K + k];
  return 0;
}

/* Harmonics F (P, D, K) of the last cycle's stress by those of strain X (P, D, K), and their
 * derivative J (P, D, K, D, K), or none, of a law without rate. Xd are those of d strain / d phase,
 * synthesis (T, K) the T samples between which a rate of strain changes its sign once at most; rules
 * as in make_grid. begun (P, E, M) are the states at the start of the last cycle, s those at its end.
 * Nonzero: out of memory.
 */
int law_harmonic(int P, int E, int K, int T, int cycles, int order, const double *X,
                 const double *Xd, const double *synthesis, const double *rules, const double *p,
                 double *s, double *begun, double *F, double *J)
{
  const int B = (K + 3) / 4, groups = (E + W - 1) / W, n = groups * W;
  const size_t columns = (size_t)D * B;
  room r = {.B = B, .groups = groups};
  grid grids[2] = {{0}, {0}};
  instants ends = {0};
  r.s = malloc(((size_t)n * (M + NP + D * M) + K) * sizeof(double));
  r.moved = malloc((size_t)n * sizeof(int));
  r.ds = malloc(((size_t)n * M + D + STEPS * D + D * K) * columns * sizeof(four));
  int failed = !r.s || !r.moved || !r.ds;
  /* Where many elements share the stress, each end of a piece matters less. */
  const double least = TURN / T * smaller(E, 64) / 1024;
  if (!failed) {
    r.p = r.s + n * M;
    r.fs = r.p + n * NP;
    r.rest = r.ds + n * M * columns;
    r.df = r.rest + D * columns;
    r.J = r.df + STEPS * D * columns;
  }
  for (int i = 0; i < P && !failed; ++i) {
    const size_t at = (size_t)i * E;
    watched w = {.K = K, .Z = X + (size_t)i * D * K, .Zd = Xd + (size_t)i * D * K,
                 .b = r.fs + n * D * M};
    ends.n = 0;
    for (int t = 0; t <= T; ++t) note(&ends, TURN * t / T, 1, -1);
    reversals(&w, T, synthesis, &ends);
    if ((failed = ends.failed)) break;
    sort_instants(&ends, SAME);
    if ((failed = make_grid(&w, &ends, 0, order, rules, B, grids))) break;
    instants all = {0};
    for (int t = 0; t < ends.n; ++t) note(&all, ends.of[t].at, 1, ends.of[t].component);
    group(E, M, s + at * M, r.s);
    group(E, NP, p + at * NP, r.p);
    failed = element_instants(&w, E, cycles, p + at * NP, &ends, &r, &all) || all.failed;
    if (!failed) {
      sort_instants(&all, least);
      failed = make_grid(&w, &all, 1, order, rules, B, grids + 1);
    }
    free(all.of);
    if (failed) break;
    group(E, M, s + at * M, r.s);
    run_point(E, K, cycles, grids, F + (size_t)i * D * K,
              J ? J + (size_t)i * D * K * D * K : NULL, begun + at * M, &r);
    ungroup(E, M, r.s, s + at * M);
  }
  for (int i = 0; i < 2; ++i) {
    free(grids[i].at); free(grids[i].e); free(grids[i].g);
  }
  free(ends.of); free(r.s); free(r.moved); free(r.ds);
  return failed;
}
