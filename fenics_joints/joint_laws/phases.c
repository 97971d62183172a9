/* Phases at which the switches of a law change their signs. Phases go from 0 to 2 pi; Z are
 * harmonics of the input, (DI, K), Zd those of its derivative by the phase.
 */
#define NS1 (NS > 0 ? NS : 1)
#define TURN 6.283185307179586477
#define BISECTIONS 40
#define NEWTONS 60
#define NEAR 1e-7 /* a step of Newton's method after which the error is its square */

/* 1, cos, sin, cos 2, sin 2, ... of a phase. */
static void harmonics_at(double phase, int K, double *b)
{
  const double c = cos(phase), s = sin(phase);
  double ck = c, sk = s;
  b[0] = 1.0;
  for (int k = 1; k < K; k += 2) {
    b[k] = ck;
    b[k + 1] = sk;
    const double next = ck * c - sk * s;
    sk = sk * c + ck * s;
    ck = next;
  }
}

static void combine(int K, const double *Z, const double *restrict b, double *e)
{
  for (int i = 0; i < DI; ++i) {
    double sums[4] = {0.0}; /* that need not wait for each other */
    int k = 0;
    for (; k + 4 <= K; k += 4)
      for (int l = 0; l < 4; ++l) sums[l] += Z[i * K + k + l] * b[k + l];
    for (; k < K; ++k) sums[k % 4] += Z[i * K + k] * b[k];
    e[i] = (sums[0] + sums[1]) + (sums[2] + sums[3]);
  }
}

/* What one switch of an element is looked at with; s is the element's state. */
typedef struct {
  int K, number;
  const double *Z, *Zd, *s, *p;
  double *b;
} watched;

static double along(const double *ge, const double *de)
{
  double sum = 0.0;
  for (int i = 0; i < DI; ++i) sum += ge[i] * de[i];
  return sum;
}

/* The switch at an input and its derivative by the phase, and its slope by it. */
static double look_at(const watched *w, const double *e, const double *de, double *slope)
{
  double g[NS1], ge[NS1 * DI];
  switches(e, w->s, w->p, g, ge);
  *slope = along(ge + w->number * DI, de);
  return g[w->number];
}

/* The switch at a phase, and its slope by it. */
static double look(const watched *w, double phase, double *slope)
{
  double e[DI], de[DI];
  harmonics_at(phase, w->K, w->b);
  combine(w->K, w->Z, w->b, e);
  combine(w->K, w->Zd, w->b, de);
  return look_at(w, e, de, slope);
}

/* The phase between low and high, where the switch is before and after, at which it changes its sign,
 * by Newton's method.
 */
static double crossing(const watched *w, double low, double high, double before, double after)
{
  double slope, x = low + (high - low) * before / (before - after);
  const int positive = before >= 0;
  for (int i = 0; i < NEWTONS; ++i) {
    if (!(x > low && x < high)) x = 0.5 * (low + high);
    const double g = look(w, x, &slope);
    if ((g >= 0) == positive) low = x;
    else high = x;
    const double moved = g / slope;
    x -= moved;
    if (fabs(moved) < NEAR && x > low - NEAR && x < high + NEAR) break;
  }
  return fmin(fmax(x, low), high);
}
