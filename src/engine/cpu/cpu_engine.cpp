// Filters tiles of blocks with the SIMD kernels, and falls back on the float engine.
#include "engine/cpu/cpu_engine.hpp"

#include <algorithm>
#include <set>
#include <tuple>

#include <opencv2/core.hpp>

#include "base/parallel.hpp"
#include "engine/engine.hpp"
#include "inverse/filter_bank.hpp"

namespace gyro_deblur {
namespace {

constexpr int kAlignBytes = 64;
constexpr int kAlignFloats = kAlignBytes / sizeof(float);

/// Calls work(begin, length) for the fewest, equally long parts of [begin, end) that are no longer than `longest`.
template <typename Work>
void for_each_part(int begin, int end, int longest, const Work& work) {
  const int parts = (end - begin + longest - 1) / longest;
  for (int i = 0; i < parts; ++i) {
    const int from = begin + (end - begin) * i / parts, to = begin + (end - begin) * (i + 1) / parts;
    work(from, to - from);
  }
}

/// Has the processor load what a plan reads of a kernel first. A bank has more kernels than a cache holds.
void prefetch_kernel(const LineKernel& kernel) {
  constexpr int kLines = 4;  // the processor itself loads those behind
  const auto middle = static_cast<std::size_t>(kernel.radius());
  const std::size_t end = std::min(kernel.taps.size(), middle + kLines * kAlignFloats);
  for (std::size_t i = middle; i < end; i += kAlignFloats) __builtin_prefetch(kernel.taps.data() + i);
}

}  // namespace

CpuEngine::CpuEngine(int threads, const BlockSimd& kernels)
    : BlockEngine(threads), kernels_(kernels), tap_simd_(*find_for_cpu<TapSimd>(kernels.name)), float_(threads) {}

std::string CpuEngine::name() const { return std::string("cpu-") + kernels_.name; }

void CpuEngine::prepare(const std::vector<const LineKernel*>& kernels) {
  std::set<TwoScaleShape> shapes;
  for (const LineKernel* kernel : kernels) {
    if (takes_two_scales(*kernel)) add_two_scale_shapes(*kernel, shapes);
  }
  designs_.keep_only(shapes);
  const std::vector<TwoScaleShape> list(shapes.begin(), shapes.end());
  parallel_for(static_cast<int>(list.size()), threads(), 1,
               [&](int i) { designs_.get(list[i], [&] { return TwoScaleDesign(list[i].first, list[i].second); }); });
}

void CpuEngine::plan_block(const BlockFilter& block, int depth, Plan& plan) {
  const LineKernel& kernel = *block.kernel;
  const LineDirection line = direction_of(block.angle_rad);
  plan.major_is_y = line.major_is_y;
  plan.slope = line.slope;
  plan.max_rows = kMaxTileSide;
  plan.fallback = fallback_reason(kernel, line.slope, depth);
  if (!plan.fallback.empty()) return;
  plan.sheared = takes_sheared_columns(kernel, line.slope, depth);
  if (plan.sheared) {
    plan.max_rows = max_sheared_rows(kernel, line.slope);
    if (takes_two_scales(kernel)) {
      make_two_scale_taps(kernel, line.major, depth == CV_8U, tap_simd_, designs_, plan.two_scale);
    } else {
      make_sheared_taps(kernel, line.major, depth == CV_8U, plan.two_scale);
    }
  } else {
    make_exact_taps(kernel, line, kernels_.has_byte_weights, plan.exact);
  }
}

void CpuEngine::plan_blocks(const FilterGrid& grid, const std::vector<int>& blocks, int depth) {
  const int count = static_cast<int>(blocks.size());
  plans_.resize(std::max(plans_.size(), blocks.size()));
  constexpr int kBlocksAtATime = 8;
  constexpr int kBlocksAhead = 4;
  parallel_for(count, threads(), kBlocksAtATime, [&](int i) {
    if (i + kBlocksAhead < count) prefetch_kernel(*grid.blocks[blocks[i + kBlocksAhead]].kernel);
    plan_block(grid.blocks[blocks[i]], depth, plans_[i]);
  });
  fallback_counts_.clear();
  left_to_float_.clear();
  for (int i = 0; i < count; ++i) {
    if (plans_[i].fallback.empty()) continue;
    ++fallback_counts_[plans_[i].fallback];
    left_to_float_.push_back(blocks[i]);
  }
}

TileNeeds CpuEngine::cut_tiles(const std::vector<int>& blocks, int depth, const SeamBlender& seams) {
  tiles_.clear();
  TileNeeds needs{};
  const auto two_scale_needs = depth == CV_8U ? kernels_.two_scale_u8_needs : kernels_.two_scale_u16_needs;
  for (int i = 0; i < static_cast<int>(blocks.size()); ++i) {
    const Plan& plan = plans_[i];
    if (!plan.fallback.empty()) continue;
    const cv::Rect reach = seams.reach(blocks[i]);
    const int max_height = plan.major_is_y ? plan.max_rows : kMaxTileSide;
    const int max_width = plan.major_is_y ? kMaxTileSide : plan.max_rows;
    for_each_part(reach.y, reach.br().y, max_height, [&](int y, int height) {
      for_each_part(reach.x, reach.br().x, max_width, [&](int x, int width) {
        Tile tile{{}, {x, y, width, height}, blocks[i], &plan};
        tile.geometry = plan.major_is_y ? TileGeometry{y, height, x, width, plan.slope}
                                        : TileGeometry{x, width, y, height, plan.slope};
        const TileNeeds of_tile = plan.sheared ? two_scale_needs(tile.geometry, plan.two_scale.filter)
                                               : kernels_.exact_needs(tile.geometry, plan.exact.filter);
        needs.scratch_floats = std::max(needs.scratch_floats, of_tile.scratch_floats);
        needs.columns = std::max(needs.columns, of_tile.columns);
        tiles_.push_back(tile);
      });
    });
  }

  // Tiles that follow each other along m read nearly the same rows, which are then still in the second-level cache.
  std::sort(tiles_.begin(), tiles_.end(), [](const Tile& a, const Tile& b) {
    const auto key = [](const Tile& tile) {
      return std::make_tuple(tile.plan->major_is_y, tile.geometry.n_begin, tile.geometry.m_begin);
    };
    return key(a) < key(b);
  });
  return needs;
}

template <typename Pixel>
void CpuEngine::run_tile(const SourcePlane<Pixel>& source, const Tile& tile, float* scratch, Pixel* line_order) const {
  const Plan& plan = *tile.plan;
  if constexpr (sizeof(Pixel) == 1) {
    if (plan.sheared) {
      kernels_.two_scale_u8(source, tile.geometry, plan.two_scale.filter, scratch, line_order);
    } else {
      kernels_.exact_u8(source, tile.geometry, plan.exact.filter, scratch, line_order);
    }
  } else {
    kernels_.two_scale_u16(source, tile.geometry, plan.two_scale.filter, scratch, line_order);
  }
}

template <typename Pixel>
void CpuEngine::run_tiles(const cv::Mat& plane, int pad, int channel, PlaneBuffers<Pixel>& buffers, SeamBlender& seams,
                          cv::Mat& dst) {
  // Tiles are sorted: first those of the transposed plane.
  SourcePlane<Pixel> upright{}, transposed{};
  if (tiles_.back().plan->major_is_y) upright = upright_plane(plane, pad, threads(), buffers.edges);
  if (!tiles_.front().plan->major_is_y) transposed = transposed_plane(plane, pad, threads(), buffers.transposed);
  const int tile_count = static_cast<int>(tiles_.size());
  constexpr int kTilesAtATime = 8;
  parallel_for(tile_count, static_cast<int>(scratch_.size()), kTilesAtATime, [&](int i, int thread) {
    const Tile& tile = tiles_[i];
    const bool major_is_y = tile.plan->major_is_y;
    alignas(kAlignBytes) Pixel line_order[kMaxTileSide * kTileStride];
    float* scratch = scratch_[thread].data();
    const std::uintptr_t past_line = reinterpret_cast<std::uintptr_t>(scratch) % kAlignBytes;
    if (past_line != 0) scratch += (kAlignBytes - past_line) / sizeof(float);
    run_tile(major_is_y ? upright : transposed, tile, scratch, line_order);
    store_tile(line_order, tile.rect, major_is_y, tile.block, channel, seams, dst);
  });
}

void CpuEngine::filter_blocks(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks,
                              SeamBlender& seams, cv::Mat& dst) {
  plan_blocks(grid, blocks, src.depth());
  float_.filter_blocks(src, grid, left_to_float_, seams, dst);
  const TileNeeds needs = cut_tiles(blocks, src.depth(), seams);
  if (tiles_.empty()) return;
  scratch_.resize(threads());
  for (std::vector<float>& scratch : scratch_) {
    scratch.resize(std::max(scratch.size(), needs.scratch_floats + kAlignFloats));
  }
  for (int channel = 0; channel < src.channels(); ++channel) {
    cv::Mat plane = src;
    if (src.channels() > 1) {
      cv::extractChannel(src, channel_, channel);
      plane = channel_;
    }
    if (src.depth() == CV_8U) {
      run_tiles(plane, needs.columns, channel, buffers8_, seams, dst);
    } else {
      run_tiles(plane, needs.columns, channel, buffers16_, seams, dst);
    }
  }
}

}  // namespace gyro_deblur
