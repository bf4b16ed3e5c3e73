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
//   LANES, VECTORS, ROWS      outputs of a work-item at a time: ROWS rows of VECTORS vectors of LANES (1, 4, 8 or 16)
//   GROUP_COLS, GROUP_ROWS    work-items of a work-group
//   TILE_COLS, TILE_ROWS      outputs of a work-group, at most
//   STAGE_STEPS               steps whose input is brought to local memory at a time; 0: rely on the caches
//   MULTIPLY_ADD              mad, or fma where the device has it in hardware and does not use it for mad
//   PATCH                     side of the square that a work-item of load_plane fills

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)

#if LANES == 1
typedef float floatN;
typedef PIXEL pixelN;
#define LOAD(from) (*(from))
#define STORE(value, to) (*(to) = (value))
#define TO_PIXEL(value) ((PIXEL)(value))
#else
typedef JOIN(float, LANES) floatN;
typedef JOIN(PIXEL, LANES) pixelN;
#define LOAD(from) JOIN(vload, LANES)(0, from)
#define STORE(value, to) JOIN(vstore, LANES)(value, 0, to)
#define TO_PIXEL(value) JOIN(convert_, JOIN(PIXEL, LANES))(value)
#endif

#define SPAN (LANES * VECTORS)

#if STAGE_STEPS
#define SOURCE_SPACE __local
#define STAGE_COLS (TILE_COLS + STAGE_STEPS)
#define STAGE_ROWS (TILE_ROWS + STAGE_STEPS + 1)
#else
#define SOURCE_SPACE __global
#endif

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

#if STAGE_STEPS
// A step as its work-group uses it: of four words, so that it is loaded at once.
typedef struct {
  int from;  // of the first output's input, in the stage
  float lower, upper, unused;
} __attribute__((aligned(16))) StagedStep;
#endif

// Plane geometry: pixel (u, v) of the image is at (v + border_v) * stride + u + border_u.

// Fills one channel's plane, border included, with replicated edge pixels.
__kernel void load_plane(__global const PIXEL* restrict image, const int channel, const int step_u, const int step_v,
                         const int size_u, const int size_v, __global float* restrict plane, const int stride,
                         const int rows, const int border_u, const int border_v) {
  const int u0 = (int)get_global_id(0) * PATCH;
  const int v0 = (int)get_global_id(1) * PATCH;
  const int cols = min(PATCH, stride - u0), last = min(v0 + PATCH, rows);
  const int from_u = u0 - border_u;
  const bool inside = from_u >= 0 && from_u + PATCH <= size_u;
  for (int v = v0; v < last; ++v) {
    __global const PIXEL* from = image + channel + clamp(v - border_v, 0, size_v - 1) * step_v;
    __global float* to = plane + v * stride + u0;
    if (inside && step_u == 1) {
      for (int i = 0; i < cols; ++i) to[i] = from[from_u + i];
    } else if (inside) {
      int i = 0;
      // Written out, since compilers leave a loop of strided loads in scalars.
      for (; i + 8 <= cols; i += 8) {
        __global const PIXEL* at = from + (from_u + i) * step_u;
        vstore8((float8)(at[0], at[step_u], at[2 * step_u], at[3 * step_u], at[4 * step_u], at[5 * step_u],
                         at[6 * step_u], at[7 * step_u]), 0, to + i);
      }
      for (; i < cols; ++i) to[i] = from[(from_u + i) * step_u];
    } else {
      for (int i = 0; i < cols; ++i) to[i] = from[clamp(from_u + i, 0, size_u - 1) * step_u];
    }
  }
}

// Adds one step to the sums; `from` is the input of the first output's `upper` weight.
static inline __attribute__((always_inline)) void add_step(floatN sums[ROWS][VECTORS], SOURCE_SPACE const float* from,
                                                           const int stride, const float lower, const float upper) {
#pragma unroll
  for (int vector = 0; vector < VECTORS; ++vector) {
    floatN above = LOAD(from + vector * LANES);
#pragma unroll
    for (int row = 0; row < ROWS; ++row) {
      const floatN here = LOAD(from + (row + 1) * stride + vector * LANES);
      sums[row][vector] = MULTIPLY_ADD(here, (floatN)(lower), MULTIPLY_ADD(above, (floatN)(upper), sums[row][vector]));
      above = here;
    }
  }
}

static inline __attribute__((always_inline)) void copy_out(PIXEL rounded[ROWS][SPAN], const int cols, const int rows,
                                                           __global PIXEL* to, const int step_u, const int step_v) {
  if (step_u == 1) {
    for (int row = 0; row < rows; ++row) {
      for (int col = 0; col < cols; ++col) to[row * step_v + col] = rounded[row][col];
    }
  } else if (step_v == 1) {
    for (int col = 0; col < cols; ++col) {
      for (int row = 0; row < rows; ++row) to[row + col * step_u] = rounded[row][col];
    }
  } else {
    for (int row = 0; row < rows; ++row) {
      for (int col = 0; col < cols; ++col) to[row * step_v + col * step_u] = rounded[row][col];
    }
  }
}

// Rounds, clips and stores the wanted part of the sums.
static inline __attribute__((always_inline)) void store(floatN sums[ROWS][VECTORS], const int cols, const int rows,
                                                        __global PIXEL* to, const int step_u, const int step_v) {
  PIXEL rounded[ROWS][SPAN];
#pragma unroll
  for (int row = 0; row < ROWS; ++row) {
#pragma unroll
    for (int vector = 0; vector < VECTORS; ++vector) {
      const floatN clipped = clamp(sums[row][vector], (floatN)(0.0f), (floatN)(PIXEL_MAX)) + 0.5f;
      STORE(TO_PIXEL(clipped), rounded[row] + vector * LANES);
    }
  }
  // Loops of known length, where nothing is cut off, become vectors.
  if (cols >= SPAN && rows >= ROWS) {
    copy_out(rounded, SPAN, ROWS, to, step_u, step_v);
  } else {
    copy_out(rounded, min(cols, SPAN), min(rows, ROWS), to, step_u, step_v);
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

#if STAGE_STEPS
  // The tile is one sub-tile for each work-item.
  __local float stage[STAGE_ROWS * STAGE_COLS];
  __local StagedStep staged_steps[STAGE_STEPS];
  const int u = local_u * SPAN, v = local_v * ROWS;
  floatN sums[ROWS][VECTORS];
#pragma unroll
  for (int row = 0; row < ROWS; ++row) {
#pragma unroll
    for (int vector = 0; vector < VECTORS; ++vector) sums[row][vector] = 0.0f;
  }
  for (int first = 0; first < tile.steps; first += STAGE_STEPS) {
    const int count = min(STAGE_STEPS, tile.steps - first);
    const int last_m = tile.first_m + first + count - 1;
    const int n_of_first = steps[first].across, n_of_last = steps[first + count - 1].across;
    const int most_n = max(n_of_first, n_of_last);
    const int stage_cols = TILE_COLS + count - 1;
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
      add_step(sums, stage + v * STAGE_COLS + u + step.from, STAGE_COLS, step.lower, step.upper);
    }
  }
  store(sums, tile.cols - u, tile.rows - v, to + v * step_v + u * step_u, step_u, step_v);
#else
  for (int v = local_v * ROWS; v < tile.rows; v += GROUP_ROWS * ROWS) {
    for (int u = local_u * SPAN; u < tile.cols; u += GROUP_COLS * SPAN) {
      floatN sums[ROWS][VECTORS];
#pragma unroll
      for (int row = 0; row < ROWS; ++row) {
#pragma unroll
        for (int vector = 0; vector < VECTORS; ++vector) sums[row][vector] = 0.0f;
      }
      __global const float* from = origin + (v - 1) * stride + u - tile.first_m;
      for (int i = 0; i < tile.steps; ++i) {
        add_step(sums, from - steps[i].across * stride - i, stride, steps[i].lower, steps[i].upper);
      }
      store(sums, tile.cols - u, tile.rows - v, to + v * step_v + u * step_u, step_u, step_v);
    }
  }
#endif
}
