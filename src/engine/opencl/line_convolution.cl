// A 1-D kernel along a line for every block of an image.
//
// A line is walked along its major axis, one step a pixel; each step has the weights of two neighbouring pixels across.
// Blocks whose major axis is y work on a transposed plane, so that here the major axis always runs along memory ("u")
// and the other across ("v"). Output (u, v) = sum over steps (m, n) of
//   lower * in(u - m, v - n) + upper * in(u - m, v - n - 1),
// so that a work-item with ROWS outputs above each other loads ROWS + 1 pixels for 2 * ROWS multiply-adds.
//
// Build options:
//   PIXEL, PIXEL_MAX          type of a pixel (uchar or ushort) and its largest value
//   ROWS                      outputs of a work-item, above each other
//   GROUP_COLS, GROUP_ROWS    work-items of a work-group
//   MULTIPLY_ADD              mad, or fma where the device has it in hardware and does not use it for mad

// A tile, which a work-group computes, has GROUP_COLS x TILE_ROWS outputs at most.
#define TILE_ROWS (GROUP_ROWS * ROWS)

// Steps whose input is brought to local memory at a time. The input of 32 takes 23 KiB and serves 18 multiply-adds for
// every float.
#define STAGE_STEPS 32
#define STAGE_COLS (GROUP_COLS + STAGE_STEPS)
#define STAGE_ROWS (TILE_ROWS + STAGE_STEPS + 1)

// The layouts of these two are repeated in opencl_engine.cpp.
typedef struct {
  int across;  // n of the step
  float lower, upper;
} Step;

typedef struct {
  int u, v, cols, rows;            // outputs of the tile, in the plane without its border
  int first_step, steps, first_m;  // steps have consecutive m
  int transposed;
  int to, step_y;  // where the first output goes, and the distance of the next row of the result there
} Tile;

// A step as its work-group uses it: of four words, so that it is loaded at once.
typedef struct {
  int from;  // of the first output's input, in the stage
  float lower, upper, unused;
} __attribute__((aligned(16))) StagedStep;

// Plane geometry: pixel (u, v) of the image is at (v + border_v) * stride + u + border_u.

// Fills one channel's plane, border included, with replicated edge pixels.
__kernel void load_plane(__global const PIXEL* restrict image, const int channel, const int step_u, const int step_v,
                         const int size_u, const int size_v, __global float* restrict plane, const int stride,
                         const int rows, const int border_u, const int border_v) {
  const int u = (int)get_global_id(0), v = (int)get_global_id(1);
  if (u >= stride || v >= rows) return;
  const int from_u = clamp(u - border_u, 0, size_u - 1), from_v = clamp(v - border_v, 0, size_v - 1);
  plane[v * stride + u] = image[channel + from_v * step_v + from_u * step_u];
}

// Adds one step to the sums; `from` is the input of the first output's `upper` weight.
static inline __attribute__((always_inline)) void add_step(float sums[ROWS], __local const float* from,
                                                           const float lower, const float upper) {
  float above = from[0];
#pragma unroll
  for (int row = 0; row < ROWS; ++row) {
    const float here = from[(row + 1) * STAGE_COLS];
    sums[row] = MULTIPLY_ADD(here, lower, MULTIPLY_ADD(above, upper, sums[row]));
    above = here;
  }
}

// Rounds, clips and stores the wanted sums.
static inline __attribute__((always_inline)) void store(float sums[ROWS], const int rows, __global PIXEL* to,
                                                        const int step_v) {
#pragma unroll
  for (int row = 0; row < ROWS; ++row) {
    if (row < rows) to[row * step_v] = (PIXEL)(clamp(sums[row], 0.0f, (float)(PIXEL_MAX)) + 0.5f);
  }
}

// One work-group a tile. step_x: distance of neighbouring pixels of the result in memory.
__kernel __attribute__((reqd_work_group_size(GROUP_COLS, GROUP_ROWS, 1))) void convolve_tiles(
    __global const Tile* restrict tiles, __global const Step* restrict all_steps,
    __global const float* restrict upright, const int upright_stride, const int upright_border_u,
    const int upright_border_v,
    __global const float* restrict transposed, const int transposed_stride, const int transposed_border_u,
    const int transposed_border_v, __global PIXEL* restrict result, const int channel, const int step_x) {
  const Tile tile = tiles[get_group_id(0)];
  __global const float* plane = tile.transposed ? transposed : upright;
  const int stride = tile.transposed ? transposed_stride : upright_stride;
  const int border_u = tile.transposed ? transposed_border_u : upright_border_u;
  const int border_v = tile.transposed ? transposed_border_v : upright_border_v;
  const int step_u = tile.transposed ? tile.step_y : step_x;
  const int step_v = tile.transposed ? step_x : tile.step_y;
  __global const Step* steps = all_steps + tile.first_step;
  __global PIXEL* to = result + channel + tile.to;
  __global const float* origin = plane + (tile.v + border_v) * stride + tile.u + border_u;
  const int local_u = (int)get_local_id(0), local_v = (int)get_local_id(1);

  __local float stage[STAGE_ROWS * STAGE_COLS];
  __local StagedStep staged_steps[STAGE_STEPS];
  const int v = local_v * ROWS;
  float sums[ROWS];
#pragma unroll
  for (int row = 0; row < ROWS; ++row) sums[row] = 0.0f;
  for (int first = 0; first < tile.steps; first += STAGE_STEPS) {
    const int count = min(STAGE_STEPS, tile.steps - first);
    const int last_m = tile.first_m + first + count - 1;
    const int n_of_first = steps[first].across, n_of_last = steps[first + count - 1].across;
    const int most_n = max(n_of_first, n_of_last);
    const int stage_cols = GROUP_COLS + count - 1;
    const int stage_rows = TILE_ROWS + 1 + most_n - min(n_of_first, n_of_last);
    __global const float* corner = origin - (most_n + 1) * stride - last_m;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int row = local_v; row < stage_rows; row += GROUP_ROWS) {
      for (int col = local_u; col < stage_cols; col += GROUP_COLS) {
        stage[row * STAGE_COLS + col] = corner[row * stride + col];
      }
    }
    for (int i = local_v * GROUP_COLS + local_u; i < count; i += GROUP_COLS * GROUP_ROWS) {
      const Step step = steps[first + i];
      const StagedStep staged = {(most_n - step.across) * STAGE_COLS + count - 1 - i, step.lower, step.upper, 0};
      staged_steps[i] = staged;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int i = 0; i < count; ++i) {
      const StagedStep step = staged_steps[i];
      add_step(sums, stage + v * STAGE_COLS + local_u + step.from, step.lower, step.upper);
    }
  }
  if (local_u < tile.cols) store(sums, tile.rows - v, to + v * step_v + local_u * step_u, step_v);
}
