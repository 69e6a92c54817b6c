// The mass-plant sweep of jaxact as a hand-vectorised C loop: the same arithmetic per control
// period (delay line, exact second-order response, exact mass, PD, all metrics), single precision,
// 16 loops to a vector, one thread per half of the loops. Built and used by `make bench` only.

#include <pthread.h>
#include <stddef.h>

typedef float vec __attribute__((vector_size(64)));
typedef int ivec __attribute__((vector_size(64)));
enum { LANES = 16 };
#define NEVER 3.0e38f

#ifndef SLOTS
#define SLOTS 6
#endif

// Inputs, one row of `count` floats each, in this order.
enum {
  KP, KD, FEEDFORWARD, SETPOINT, START, PER_SPAN,
  STEP, MEAN_GAIN, MOMENT_GAIN,
  FORCE_E, FORCE_G, FORCE_D, RATE_E, RATE_G, RATE_D,
  MEAN_E, MEAN_G, MEAN_D, MOMENT_E, MOMENT_G, MOMENT_D,
  SELECT, INPUTS = SELECT + SLOTS
};

// Outputs, one row each: the accumulators, those of the four envelopes last.
enum {
  HIGHEST, FARTHEST, LOW, HIGH, UNSETTLED, ABSOLUTE, SQUARED, EFFORT, PEAK_FORCE, SQUARED_FORCE, POSITION,
  ENVELOPES, ENVELOPE_ROWS = 5, SEGMENTS = 4, OUTPUTS = ENVELOPES + ENVELOPE_ROWS * SEGMENTS
};

static inline vec pick(ivec mask, vec yes, vec no) {
  return (vec)((mask & (ivec)yes) | (~mask & (ivec)no));
}
static inline vec size(vec x) { return (vec)((ivec)x & 0x7fffffff); }
static inline vec larger(vec x, vec y) { return pick(x > y, x, y); }
static inline vec smaller(vec x, vec y) { return pick(x < y, x, y); }

// The first time that a response passes a level, linear between ticks; FLT_MAX until then.
static inline vec pass(vec passed, vec before, vec after, float level, float tick) {
  ivec now = (passed == NEVER) & (after >= level);
  return pick(now, tick - (after - level) / (after - before), passed);
}

static void sixteen_loops(const float *inputs, float *outputs, size_t count, size_t at, int ticks) {
  vec in[INPUTS], commands[SLOTS], zero = {};
  for (int row = 0; row < INPUTS; row++)
    in[row] = *(const vec *)(inputs + row * count + at);
  for (int slot = 0; slot < SLOTS; slot++) commands[slot] = zero;
  vec q = in[START], v = zero, f = zero, g = zero, older = zero, newer = zero;
  vec highest = zero, farthest = zero, unsettled = zero, absolute = zero, squared = zero;
  vec effort = zero, peak_force = zero, squared_force = zero;
  vec per_size = size(in[PER_SPAN]);
  vec low = zero + NEVER, high = zero + NEVER;
  float tick = 0.0f;
  for (int segment = 0; segment < SEGMENTS; segment++) {
    vec lowest = zero + 1e38f, top = zero - 1e38f, turns = zero, first = zero, last = zero;
    for (int k = 0; k < ticks / SEGMENTS; k++) {
      tick += 1.0f;
      vec u = in[KP] * (in[SETPOINT] - q) + in[KD] * (zero - v) + in[FEEDFORWARD];
      older = newer;
      for (int slot = SLOTS - 1; slot > 0; slot--) commands[slot] = commands[slot - 1];
      commands[0] = u;
      newer = in[SELECT] * commands[0];
      for (int slot = 1; slot < SLOTS; slot++) newer += in[SELECT + slot] * commands[slot];
      vec q_before = q, v_before = v;
      vec e = f - newer, d = older - newer;
      vec mean = newer + (in[MEAN_E] * e + in[MEAN_G] * g + in[MEAN_D] * d);
      vec moment = newer + (in[MOMENT_E] * e + in[MOMENT_G] * g + in[MOMENT_D] * d);
      f = newer + (in[FORCE_E] * e + in[FORCE_G] * g + in[FORCE_D] * d);
      g = in[RATE_E] * e + in[RATE_G] * g + in[RATE_D] * d;
      q += in[STEP] * v + in[MOMENT_GAIN] * moment;
      v += in[MEAN_GAIN] * mean;

      vec error = q - in[SETPOINT], away = size(error), response = (q - in[START]) * in[PER_SPAN];
      vec response_before = (q_before - in[START]) * in[PER_SPAN];
      highest = larger(response, highest);
      farthest = larger(away, farthest);
      low = pass(low, response_before, response, 0.1f, tick);
      high = pass(high, response_before, response, 0.9f, tick);
      unsettled = pick(away * per_size > 0.02f, zero + tick, unsettled);
      absolute += away;
      squared += error * error;
      effort += u * u;
      peak_force = larger(size(mean), peak_force);
      squared_force += mean * mean;

      ivec turned = (v_before < 0.0f) & (v >= 0.0f);
      first = pick(turned & (turns == 0.0f), zero + tick, first);
      last = pick(turned, zero + tick, last);
      turns += pick(turned, zero + 1.0f, zero);
      lowest = smaller(q, lowest);
      top = larger(q, top);
    }
    vec rows[ENVELOPE_ROWS] = {lowest, top, turns, first, last};
    for (int row = 0; row < ENVELOPE_ROWS; row++)
      *(vec *)(outputs + (ENVELOPES + segment * ENVELOPE_ROWS + row) * count + at) = rows[row];
  }
  vec rows[ENVELOPES] = {highest, farthest, low, high, unsettled, absolute, squared, effort,
                         peak_force, squared_force, q};
  for (int row = 0; row < ENVELOPES; row++) *(vec *)(outputs + row * count + at) = rows[row];
}

typedef struct {
  const float *inputs;
  float *outputs;
  size_t count, from, to;
  int ticks;
} job;

// Numbers too small for a normal float count as zero, as in XLA: some processors take a hundred
// times as long over them.
static void flush_denormals(void) {
#ifdef __SSE__
  __builtin_ia32_ldmxcsr(__builtin_ia32_stmxcsr() | 0x8040);
#endif
}

static void *work(void *argument) {
  job *j = argument;
  flush_denormals();
  for (size_t at = j->from; at < j->to; at += LANES)
    sixteen_loops(j->inputs, j->outputs, j->count, at, j->ticks);
  return NULL;
}

// `count` loops, a multiple of 16 per thread; rows are 64-byte aligned.
void simulate(const float *inputs, float *outputs, size_t count, int ticks, int threads) {
  pthread_t handles[64];
  job jobs[64];
  if (threads > 64) threads = 64;
  size_t vectors = count / LANES;
  for (int t = 0; t < threads; t++) {
    jobs[t] = (job){inputs, outputs, count, vectors * t / threads * LANES,
                    vectors * (t + 1) / threads * LANES, ticks};
    pthread_create(&handles[t], NULL, work, &jobs[t]);
  }
  for (int t = 0; t < threads; t++) pthread_join(handles[t], NULL);
}
