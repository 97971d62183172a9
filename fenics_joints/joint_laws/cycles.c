/* Harmonics of stress of laws with memory. States go from step to step, and derivatives by the harmonics
 * of strain with them: (numbers, D, B), each B fours of harmonics.
 *
 * Sampled: the states step from sample to sample, and the stress there is summed. In one direction of
 * slip these harmonics are off by the square of the step, and as rough as the samples pass over the
 * instants where a slider turns, as its strain does, or starts to slide.
 *
 * Exact, of laws of which one step along a way without reversal is the same as many: states step at the
 * reversals of strain and, with normal strain beside slip, at some samples and where an element stops.
 * From every state Gauss's rule integrates the stress up to the next, in pieces that end where a switch
 * of an element changes its sign. Derivatives have what a reversal moves by; what moves the ends of a
 * piece changes nothing, as the stress has no jump there, nor does a stop, where the state is at rest.
 */
#define STEPS 8 /* whose derivatives are analysed at once */
#define JUST 1e-3 /* share of an interval that counts as just after its start */
#define HALVINGS 12 /* of an interval where a slider may stop: the stress feels its square */
#define SAME 1e-12 /* phases closer than that are one */
#define NOTABLE 0.1 /* a strain's rate over that of the largest below which it has no reversals */
#define PIECE 2.0 /* angle of the highest harmonic in the longest piece with one rule */
#define MARKS 4 /* per sine and cosine, least in a cycle, between which reversals and switches are found */

/* Four harmonics side by side. */
typedef double four __attribute__((vector_size(32), aligned(8), may_alias));

/* An instant: a step of the states, or just an end of a piece. It moves by these shares of d strain and
 * of its rate there. Its stress counts by its weight. What is 1, cos, sin, ... of its phase may be known.
 */
typedef struct {
  double at, weight, strain[D], rate[D];
  const double *known;
  int step;
} instant;

typedef struct {
  int n, room, failed;
  instant *of;
} instants;

/* Instants of a cycle in their order. */
typedef struct {
  int n, room, stresses;
  instant *at;
  double *e, *rates;    /* strain and its rate, (n, D) */
  double *columns, *analysis; /* (stresses, K), (K, stresses) */
  four *g, *shift;      /* harmonics (n, B), and d phase / d X (n, D, B) */
} grid;

typedef struct {
  int B, groups;
  double *s, *p; /* states and parameters of a point's elements, in groups */
  double *switches; /* of a group's elements before and after, (groups, 2, NS1, W) */
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

/* One element's part in the derivatives at instant i, df of its stress or none. */
static void follow(int at, int l, int moving, const derived *now, const grid *on, int i, four *df,
                   room *r)
{
  const int B = r->B, step = moving && on->at[i].step;
  double fs[D * M] = {0.0}, *held = r->fs + at * D * M;
  four *restrict ds = r->ds + (size_t)at * M * D * B;
  if (!df && !step) return;
  for (int n = 0; df && n < D * M; ++n) fs[n] = now->fs[n * W + l];
  if (r->moved[at] == 2) {
    if (!step && !memcmp(fs, held, sizeof fs)) return;
    release(at, r);
  }
  if (!step && !moving) {
    /* What an element adds that does not move is the same at the next instants. */
    if (!r->moved[at]) return;
    memcpy(held, fs, sizeof fs);
    add_states(B, fs, ds, r->rest);
    r->moved[at] = 2;
    return;
  }
  if (df && r->moved[at]) add_states(B, fs, ds, df);
  if (!step) return;
  const four *g = on->g + (size_t)i * B, *shift = on->shift + (size_t)i * D * B;
  const double *rates = on->rates + (size_t)i * D;
  for (int c = 0; c < D; ++c)
    for (int k = 0; k < B; ++k) {
      four old[M];
      for (int b = 0; b < M; ++b) old[b] = ds[(b * D + c) * B + k];
      for (int a = 0; a < M; ++a) {
        four sum = now->ne[(a * D + c) * W + l] * g[k];
        for (int b = 0; b < M; ++b) sum += now->ns[(a * M + b) * W + l] * old[b];
        for (int b = 0; b < D; ++b)
          sum += now->ne[(a * D + b) * W + l] * rates[b] * shift[c * B + k];
        ds[(a * D + c) * B + k] = sum;
      }
    }
  r->moved[at] = 1;
}

/* Instant i of a point: stress f[D] and its derivative df, or none, and the step if it is one. */
static void advance(int E, const grid *on, int i, int jacobian, double *f, four *df, room *r)
{
  const int B = r->B, step = on->at[i].step;
  const double *e = on->e + (size_t)i * D;
  double fe[D * D] = {0.0};
  if (df) memset(df, 0, D * D * B * sizeof(four));
  for (int j = 0; j < r->groups; ++j) {
    derived now;
    double *s = r->s + j * W * M;
    const int count = smaller(W, E - j * W);
    int any = 0, moving[W];
    if (df) elements_d(e, s, r->p + j * W * NP, &now);
    else elements(e, s, r->p + j * W * NP, now.f, now.sn);
    if (f) add(D, count, now.f, f);
    if (df) add(D * D, count, now.fe, fe);
    for (int l = 0; jacobian && l < count; ++l) any |= moving[l] = moves(l, s, now.sn);
    if (any && !df) elements_d(e, s, r->p + j * W * NP, &now);
    for (int l = 0; (any || df) && l < count; ++l)
      follow(j * W + l, l, moving[l], &now, on, i, df, r);
    if (step) memcpy(s, now.sn, W * M * sizeof(double));
  }
  const four *g = on->g + (size_t)i * B;
  for (int a = 0; df && a < D; ++a)
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

/* A point that begins with the states r->s: no derivatives yet. */
static void begin_point(int K, room *r)
{
  const int columns = D * r->B;
  memset(r->ds, 0, (size_t)r->groups * W * M * columns * sizeof(four));
  memset(r->rest, 0, (size_t)D * columns * sizeof(four));
  memset(r->moved, 0, (size_t)r->groups * W * sizeof(int));
  memset(r->J, 0, (size_t)D * K * columns * sizeof(four));
}

/* A cycle of a point, whose stress is not asked for. */
static void run_through(int E, const grid *on, int jacobian, room *r)
{
  for (int i = 0; i < on->n; ++i)
    if (on->at[i].step) advance(E, on, i, jacobian, NULL, NULL, r);
}

/* A cycle of a point, with the stress's harmonics and their derivative, or none. */
static void analyse(int E, int K, const grid *on, double *F, double *J, room *r)
{
  const int B = r->B, columns = D * B, T = on->stresses;
  memset(F, 0, (size_t)D * K * sizeof(double));
  for (int i = 0, t = 0; i < on->n; ++i) {
    const int step = t % STEPS, counts = on->at[i].weight > 0;
    double f[D] = {0.0};
    four *df = counts && J ? r->df + (size_t)step * D * columns : NULL;
    advance(E, on, i, J != NULL, counts ? f : NULL, df, r);
    if (!counts) continue;
    for (int c = 0; c < D; ++c)
      for (int k = 0; k < K; ++k) F[c * K + k] += on->columns[(size_t)t * K + k] * f[c];
    const double *from = on->analysis + t - step;
    if (df && step == STEPS - 1) analyse_steps(STEPS, K, T, B, from, r->df, r->J);
    else if (df && t == T - 1) analyse_steps(step + 1, K, T, B, from, r->df, r->J);
    ++t;
  }
  for (int i = 0; J && i < D * K * D; ++i)
    memcpy(J + (size_t)i * K, r->J + (size_t)i * B, K * sizeof(double));
}

/* -- instants ---------------------------------------------------------------------------------- */

/* Room for one more, with nothing but a phase; where there is none, the last is lost. */
static instant *note(instants *all, double at, const double *known, int step)
{
  if (all->n == all->room) {
    const int more = 2 * all->room + 64;
    instant *of = realloc(all->of, more * sizeof(instant));
    if (!of) {
      all->failed = 1;
      return all->of + --all->n;
    }
    all->of = of;
    all->room = more;
  }
  instant *now = all->of + all->n++;
  *now = (instant){.at = at, .known = known, .step = step};
  return now;
}

static int earlier(const void *a, const void *b)
{
  const double x = ((const instant *)a)->at, y = ((const instant *)b)->at;
  return (x > y) - (x < y);
}

/* In order; those that are no steps keep `least` from all others, and give way to steps. */
static void sort_instants(instants *all, double least)
{
  int n = 0;
  least = fmax(least, SAME);
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

/* Where the rates of strain change their signs, looked at in each `stride` of T samples. */
static void reversals(const watched *w, int T, int stride, const double *synthesis, instants *to)
{
  double before[D], now[D], largest = 0.0;
  for (int c = 0; c < D; ++c) largest = fmax(largest, size(w->Zd + c * w->K, w->K));
  combine(w->K, w->Zd, synthesis, before);
  for (int last = 0; last < T; last += stride) {
    const int t = smaller(last + stride, T);
    combine(w->K, w->Zd, synthesis + (size_t)(t % T) * w->K, now);
    for (int c = 0; c < D; ++c) {
      if ((now[c] >= 0) == (before[c] >= 0)) continue;
      if (size(w->Zd + c * w->K, w->K) < NOTABLE * largest) continue;
      const double *Zd = w->Zd + c * w->K;
      double low = TURN * last / T, high = TURN * t / T, second;
      double x = low + (high - low) * before[c] / (before[c] - now[c]);
      for (int i = 0; i < NEWTONS; ++i) {
        if (!(x > low && x < high)) x = 0.5 * (low + high);
        harmonics_at(x, w->K, w->b);
        double rate = second = 0.0;
        for (int k = 1; k < w->K; k += 2) {
          rate += Zd[k] * w->b[k] + Zd[k + 1] * w->b[k + 1];
          second += 0.5 * (k + 1) * (Zd[k + 1] * w->b[k] - Zd[k] * w->b[k + 1]);
        }
        if ((rate >= 0) == (before[c] >= 0)) low = x;
        else high = x;
        const double moved = rate / second;
        x -= moved;
        if (fabs(moved) < NEAR && x > low - NEAR && x < high + NEAR) break;
      }
      /* The rate is zero: d phase = -d rate / second rate. */
      note(to, fmin(fmax(x, low), high), NULL, 1)->rate[c] = -1.0 / second;
    }
    memcpy(before, now, sizeof before);
  }
}

/* Slopes of an element's switches, with the state that it has moved to at strain and rate e, (2, D). Zero:
 * it has not moved.
 */
static int slopes_on_the_way(const watched *w, const double *e, double *slopes)
{
  double f[D], sn[M], g[NS1], ge[NS1 * D];
  element(e, w->s, w->p, f, sn);
  switches(e, sn, w->p, g, ge);
  for (int n = 0; n < NS; ++n) slopes[n] = along(ge + n * D, e + D);
  return memcmp(sn, w->s, M * sizeof(double));
}

/* Switches of a group's elements, (NS, W). */
static void group_switches(const double *restrict e, const double *restrict s,
                           const double *restrict p, double *restrict to)
{
#pragma GCC ivdep
  for (int l = 0; l < W; ++l) {
    double s1[M], p1[NP1], g[NS1], ge[NS1 * D];
    for (int i = 0; i < M; ++i) s1[i] = s[i * W + l];
    for (int i = 0; i < NP; ++i) p1[i] = p[i * W + l];
    switches(e, s1, p1, g, ge);
    for (int i = 0; i < NS; ++i) to[i * W + l] = g[i];
  }
}

/* An element's state goes to where it is at a phase. */
static void go_to(watched *w, double phase, double *state)
{
  double e[D], f[D], sn[M];
  harmonics_at(phase, w->K, w->b);
  combine(w->K, w->Z, w->b, e);
  element(e, w->s, w->p, f, sn);
  memcpy(state, sn, sizeof sn);
}

/* Changes of an element's switches between low and high, where number `of` is g0[of * W] and g1[of * W].
 * With normal strain beside slip its state goes through those that do not depend on it, as a contact
 * that closes.
 */
static void note_changes(watched *w, double low, double high, const double *g0, const double *g1,
                         double *state, instants *to)
{
  for (w->number = 0; w->number < NS; ++w->number) {
    const int n = w->number * W;
    if ((g0[n] >= 0) == (g1[n] >= 0)) continue;
    const double x = crossing(w, low, high, g0[n], g1[n]);
    instant *now = note(to, x, NULL, 0);
    if (D == 1 || !FREE[w->number]) continue;
    double e[D], de[D], g[NS1], ge[NS1 * D];
    harmonics_at(x, w->K, w->b);
    combine(w->K, w->Z, w->b, e);
    combine(w->K, w->Zd, w->b, de);
    switches(e, w->s, w->p, g, ge);
    const double slope = along(ge + w->number * D, de);
    now->step = 1;
    for (int c = 0; c < D; ++c) now->strain[c] = slope ? -ge[w->number * D + c] / slope : 0.0;
    go_to(w, x, state);
  }
}

/* A slider stops where the slope of its switch, which sliding keeps at zero, changes its sign: under a
 * pressure that varies that is no reversal of the strain. Its state goes there; e, (3, 2, D), is strain
 * and rate just after low, at high and just before it.
 */
static void note_stop(watched *w, double low, double high, const double *e, double *state,
                      instants *to)
{
  double start[NS1], end[NS1], now[NS1];
  if (!slopes_on_the_way(w, e, start)) return;
  slopes_on_the_way(w, e + 4 * D, end);
  for (int n = 0; n < NS; ++n) {
    double a = low, b = high;
    if (start[n] * end[n] >= 0) continue;
    for (int i = 0; i < HALVINGS; ++i) {
      const double middle = 0.5 * (a + b);
      double at[2 * D];
      harmonics_at(middle, w->K, w->b);
      combine(w->K, w->Z, w->b, at);
      combine(w->K, w->Zd, w->b, at + D);
      slopes_on_the_way(w, at, now);
      if (now[n] * start[n] > 0) a = middle;
      else b = middle;
    }
    note(to, a, NULL, 1);
    go_to(w, a, state);
  }
}

/* Strain and rate at a share x of an interval h, by Hermite's cubic. */
static void between(double x, double h, double e0, double rate0, double e1, double rate1, double *e,
                    double *rate)
{
  const double rise = e1 - e0, bend = h * (rate0 + rate1) - 2 * rise, first = h * rate0;
  const double second = rise - first - bend;
  *e = e0 + x * (first + x * (second + x * bend));
  *rate = (first + x * (2 * second + 3 * x * bend)) / h;
}

/* Ends of pieces of all elements in a cycle through the marks; r->s goes through the steps among them. */
static void note_ends(watched *w, int E, const grid *marks, room *r, instants *to)
{
  for (int i = 0; i < marks->n; ++i) {
    const double high = marks->at[i].at, low = i ? marks->at[i - 1].at : high;
    const double just = JUST * (high - low), *at = marks->e + i * D, *rate = marks->rates + i * D;
    double e[6 * D]; /* strain and rate just after the mark before, at the mark and just before it */
    for (int c = 0; i && c < D; ++c) {
      between(JUST, high - low, at[c - D], rate[c - D], at[c], rate[c], e + c, e + D + c);
      e[2 * D + c] = at[c];
      e[3 * D + c] = rate[c];
      between(1 - JUST, high - low, at[c - D], rate[c - D], at[c], rate[c], e + 4 * D + c,
              e + 5 * D + c);
    }
    for (int j = 0; j < r->groups; ++j) {
      const int count = i ? smaller(W, E - j * W) : 0;
      const double *p = r->p + j * W * NP;
      double f[D * W], sn[M * W], *s = r->s + j * W * M;
      double *g0 = r->switches + 2 * j * W * NS1, *g1 = g0 + W * NS1;
      if (NS && count) {
        if (marks->at[i - 1].step) group_switches(e, s, p, g0);
        else memcpy(g0, g1, W * NS1 * sizeof(double));
        group_switches(at, s, p, g1);
      }
      for (int l = 0; l < count; ++l) {
        int changes = D > 1;
        for (int n = l; n < NS * W; n += W) changes |= (g0[n] >= 0) != (g1[n] >= 0);
        if (!changes) continue;
        double own[M + NP1], gone[M];
        for (int m = 0; m < M; ++m) own[m] = gone[m] = s[m * W + l];
        for (int m = 0; m < NP; ++m) own[M + m] = p[m * W + l];
        w->s = own;
        w->p = own + M;
        note_changes(w, low + just, high, g0 + l, g1 + l, gone, to);
        if (D > 1) note_stop(w, low + just, high - just, e, gone, to);
        for (int m = 0; m < M; ++m) s[m * W + l] = gone[m];
      }
      if (!marks->at[i].step) continue;
      elements(at, s, p, f, sn);
      memcpy(s, sn, sizeof sn);
    }
  }
}

/* Room for n instants in a grid; nonzero: out of memory. */
static int empty(int n, int K, int B, grid *to)
{
  if (n > to->room) {
    free(to->at); free(to->e); free(to->g);
    to->room = 2 * n;
    to->at = malloc(to->room * sizeof(instant));
    to->e = malloc((size_t)to->room * 2 * (D + K) * sizeof(double));
    to->g = malloc((size_t)to->room * (1 + D) * B * sizeof(four));
  }
  if (!to->at || !to->e || !to->g) return 1;
  to->rates = to->e + (size_t)to->room * D;
  to->columns = to->rates + (size_t)to->room * D;
  to->analysis = to->columns + (size_t)to->room * K;
  to->shift = to->g + (size_t)to->room * B;
  to->n = to->stresses = 0;
  return 0;
}

/* Add an instant to a grid that has room for it. */
static void add_instant(const watched *w, instant now, int B, grid *to)
{
  const int i = to->n++, K = w->K;
  double *rates = to->rates + (size_t)i * D;
  to->at[i] = now;
  const double *b = now.known;
  if (!b) harmonics_at(now.at, K, w->b), b = w->b;
  combine(K, w->Z, b, to->e + (size_t)i * D);
  memset(rates, 0, D * sizeof(double)); /* at samples they count zero times, which NaN survives */
  if (!now.weight) combine(K, w->Zd, b, rates);
  four *g = to->g + (size_t)i * B, *shift = to->shift + (size_t)i * D * B;
  memset(g, 0, B * sizeof(four));
  memcpy(g, b, K * sizeof(double));
  if (now.weight > 0) {
    double *column = to->columns + (size_t)to->stresses++ * K;
    const double share = 2.0 * now.weight / TURN;
    for (int k = 0; k < K; ++k) column[k] = (k ? share : 0.5 * share) * b[k];
  }
  if (!now.step) return;
  for (int c = 0; c < D; ++c) {
    double *to_phase = (double *)(shift + c * B);
    memset(to_phase, 0, B * sizeof(four));
    /* Strain's harmonics Z and their rate's, rotation Z, per phase of a response: d rate is b' dZ. */
    for (int k = 0; now.strain[c] && k < K; ++k) to_phase[k] = now.strain[c] * b[k];
    for (int k = 1; now.rate[c] && k < K; k += 2) {
      to_phase[k] -= now.rate[c] * 0.5 * (k + 1) * b[k + 1];
      to_phase[k + 1] += now.rate[c] * 0.5 * (k + 1) * b[k];
    }
  }
}

/* What the stress's analysis needs of a grid's instants. */
static void finish(int K, grid *to)
{
  for (int t = 0; t < to->stresses; ++t)
    for (int k = 0; k < K; ++k)
      to->analysis[(size_t)k * to->stresses + t] = to->columns[(size_t)t * K + k];
}

/* The grid of a cycle with T samples, where states step and stress is summed. */
static int sampled_grid(const watched *w, int T, const double *synthesis, int B, grid *to)
{
  if (empty(T, w->K, B, to)) return 1;
  for (int t = 0; t < T; ++t)
    add_instant(w, (instant){.weight = TURN / T, .known = synthesis + (size_t)t * w->K, .step = 1}, B,
                to);
  finish(w->K, to);
  return 0;
}

/* The grid of a cycle's steps and of the marks at which its switches are looked at. */
static int marks_grid(watched *w, int T, const double *synthesis, int B, instants *marks, grid *to)
{
  const int K = w->K, stride = T < 2 * MARKS * K ? 1 : T / (MARKS * K);
  marks->n = 0;
  for (int t = 0; t < T; t += stride)
    note(marks, TURN * t / T, synthesis + (size_t)t * K, D > 1 || !t);
  note(marks, TURN, synthesis, 1);
  reversals(w, T, stride, synthesis, marks);
  if (marks->failed) return 1;
  sort_instants(marks, 0.0);
  if (empty(marks->n, K, B, to)) return 1;
  for (int i = 0; i < marks->n; ++i) add_instant(w, marks->of[i], B, to);
  return 0;
}

/* The grid of a cycle that begins with the states r->s and goes through these marks, without `stresses`
 * of its steps alone. Gauss's rules, from 0 to 1, have 1 to `order` nodes.
 */
static int pieces_grid(watched *w, int E, int stresses, int order, const double *rules,
                       const grid *marks, room *r, instants *ends, grid *to)
{
  const double highest = 0.5 * (w->K - 1);
  ends->n = 0;
  for (int i = 0; i < marks->n; ++i) {
    const instant now = marks->at[i];
    if (!i || i == marks->n - 1 || !now.known) *note(ends, now.at, now.known, 1) = now;
  }
  note_ends(w, E, marks, r, ends);
  if (ends->failed) return 1;
  /* Where many elements share the stress, each end of a piece matters less. */
  sort_instants(ends, TURN * smaller(E, 64) / 1048576);
  const int most = ends->n + stresses * (ends->n + (int)(TURN * highest / PIECE)) * order;
  if (empty(most, w->K, r->B, to)) return 1;
  for (int i = 0; i < ends->n; ++i) {
    const double low = i ? ends->of[i - 1].at : 0.0, whole = ends->of[i].at - low;
    const int parts = stresses ? (int)ceil(whole * highest / PIECE) : 0;
    for (int part = 0; part < parts; ++part) {
      const double length = whole / parts, turn = length * highest, at = low + part * length;
      const int n = smaller(order, turn < 0.1 ? 2 : turn < 0.3 ? 3 : turn < 0.7 ? 4 : turn < 1.2 ? 5 : order);
      const double *rule = rules + (n - 1) * n;
      for (int q = 0; q < n; ++q)
        add_instant(w, (instant){.at = at + length * rule[q], .weight = length * rule[n + q]}, r->B, to);
    }
    if (ends->of[i].step) add_instant(w, ends->of[i], r->B, to);
  }
  finish(w->K, to);
  return 0;
}

/* Harmonics F (P, D, K) of the last cycle's stress by those of strain X (P, D, K), and their
 * derivative J (P, D, K, D, K), or none, of a law without rate; exact or sampled. Xd are those of
 * d strain / d phase, synthesis (T, K) the samples, between which a rate of strain changes its sign
 * once at most; rules as in pieces_grid. begun (P, E, M) are the states at the start of the last
 * cycle, s those at its end. Nonzero: out of memory.
 */
int law_harmonic(int P, int E, int K, int T, int cycles, int exact, int order,
                 const double *X, const double *Xd, const double *synthesis, const double *rules,
                 const double *p, double *s, double *begun, double *F, double *J)
{
  const int B = (K + 3) / 4, groups = (E + W - 1) / W, n = groups * W;
  const size_t columns = (size_t)D * B;
  room r = {.B = B, .groups = groups};
  grid grids[2] = {{0}, {0}}, *steps = grids, *pieces = grids + 1;
  instants marks = {0}, ends = {0};
  r.s = malloc(((size_t)n * (M + NP + D * M + 2 * NS1) + K) * sizeof(double));
  r.moved = malloc((size_t)n * sizeof(int));
  r.ds = malloc(((size_t)n * M + D + STEPS * D + D * K) * columns * sizeof(four));
  int failed = !r.s || !r.moved || !r.ds;
  if (!failed) {
    r.p = r.s + n * M;
    r.fs = r.p + n * NP;
    r.switches = r.fs + n * D * M;
    r.rest = r.ds + n * M * columns;
    r.df = r.rest + D * columns;
    r.J = r.df + STEPS * D * columns;
  }
  for (int i = 0; i < P && !failed; ++i) {
    const size_t at = (size_t)i * E;
    watched w = {.K = K, .Z = X + (size_t)i * D * K, .Zd = Xd + (size_t)i * D * K,
                 .b = r.switches + n * 2 * NS1};
    group(E, M, s + at * M, r.s);
    group(E, NP, p + at * NP, r.p);
    begin_point(K, &r);
    if (exact) failed = marks_grid(&w, T, synthesis, B, &marks, steps);
    else if (!i) failed = sampled_grid(&w, T, synthesis, B, steps);
    else for (int t = 0; t < T; ++t) combine(K, w.Z, synthesis + (size_t)t * K, steps->e + t * D);
    for (int cycle = 0; !failed && cycle < cycles; ++cycle) {
      const int last = cycle == cycles - 1, found = exact && (D > 1 || last);
      ungroup(E, M, r.s, begun + at * M);
      if (found) {
        failed = pieces_grid(&w, E, last, order, rules, steps, &r, &ends, pieces);
        group(E, M, begun + at * M, r.s);
      }
      if (failed) break;
      const grid *on = found ? pieces : steps;
      if (last) analyse(E, K, on, F + (size_t)i * D * K, J ? J + (size_t)i * D * K * D * K : NULL, &r);
      else run_through(E, on, J != NULL, &r);
    }
    ungroup(E, M, r.s, s + at * M);
  }
  for (int i = 0; i < 2; ++i) {
    free(grids[i].at); free(grids[i].e); free(grids[i].g);
  }
  free(marks.of); free(ends.of); free(r.s); free(r.moved); free(r.ds);
  return failed;
}
