// Pixels between an image and line order, in which rows follow the major axis of the blur: planes that tiles are read
// from, and the way of finished tiles back.
#pragma once

#include <cstdint>
#include <vector>

#include <opencv2/core.hpp>

#include "engine/cpu/block_simd.hpp"
#include "engine/seam_blender.hpp"

namespace gyro_deblur {

/// Buffers for a channel in addition to the channel itself (see SourcePlane).
template <typename Pixel>
struct PlaneBuffers {
  std::vector<Pixel> edges, transposed;
};

/// The channel itself, for a major axis along y, with copies of its left and right edges in `edges` where pad > 0. All
/// of this is for std::uint8_t and std::uint16_t; `threads` >= 1.
template <typename Pixel>
SourcePlane<Pixel> upright_plane(const cv::Mat& channel, int pad, int threads, std::vector<Pixel>& edges);

/// The transposed channel in `storage`, for a major axis along x, with `pad` pixels of its edges repeated.
template <typename Pixel>
SourcePlane<Pixel> transposed_plane(const cv::Mat& channel, int pad, int threads, std::vector<Pixel>& storage);

/// Stores one channel of a tile, of which `line_order` has kTileStride pixels a row, in the parts of its block.
template <typename Pixel>
void store_tile(const Pixel* line_order, const cv::Rect& tile, bool major_is_y, int block, int channel,
                SeamBlender& seams, cv::Mat& dst);

}  // namespace gyro_deblur
