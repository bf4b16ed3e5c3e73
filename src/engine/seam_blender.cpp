// Blends the results of neighbouring blocks.
#include "engine/seam_blender.hpp"

#include <algorithm>
#include <type_traits>

#include "base/parallel.hpp"

namespace gyro_deblur {
namespace {

constexpr int kMaxMargin = 4;
constexpr int kOne = 256;  // weights are in units of 1 / kOne
constexpr int kMaxChannels = 4;
constexpr int kMaxRamp = 2 * kMaxMargin * kMaxChannels;
constexpr std::size_t kCacheLineBytes = 64;

int margin_between(int before, int after) {
  int margin = kMaxMargin;
  while (margin > std::min(before, after) / 2) margin /= 2;
  return margin;
}

/// Step i of `steps` equal ones from 0 to kOne, rounded.
int weight_at(int i, int steps) { return (2 * i * kOne + steps) / (2 * steps); }

/// Weight of the block behind a border, at pixel i of the 2 * margin around it.
int ramp_weight(int margin, int i) { return weight_at(i + 1, 2 * margin + 1); }

/// Weight of the input k px from a copied block.
int fade_weight(int margin, int k) { return weight_at(margin - k, margin + 1); }

/// Unsigned type that holds a pixel times kOne, and half of that.
template <typename Pixel>
using Wide = std::conditional_t<sizeof(Pixel) == 1, std::uint16_t, std::uint32_t>;

/// Numbers for consecutive pixels, repeated for every channel.
struct Ramp {
  std::uint16_t weights[kMaxRamp];
};

Ramp border_ramp(int margin, int channels) {
  Ramp ramp;
  for (int i = 0; i < 2 * margin * channels; ++i) {
    ramp.weights[i] = static_cast<std::uint16_t>(ramp_weight(margin, i / channels));
  }
  return ramp;
}

/// out = before + weight (after - before). `out` may be `before`.
template <typename Pixel, typename Count>
inline void mix(const Pixel* before, const Pixel* after, const std::uint16_t* weights, Count count, Pixel* out) {
#pragma omp simd
  for (int i = 0; i < count; ++i) {
    const Wide<Pixel> weight = weights[i], rest = kOne - weight;
    const Wide<Pixel> sum = before[i] * rest + after[i] * weight + kOne / 2;
    out[i] = static_cast<Pixel>(sum / kOne);
  }
}

template <typename Pixel>
inline void mix(const Pixel* before, const Pixel* after, int weight_of_after, int count, Pixel* out) {
  const Wide<Pixel> weight = static_cast<Wide<Pixel>>(weight_of_after), rest = kOne - weight;
#pragma omp simd
  for (int i = 0; i < count; ++i) {
    const Wide<Pixel> sum = before[i] * rest + after[i] * weight + kOne / 2;
    out[i] = static_cast<Pixel>(sum / kOne);
  }
}

/// Four blocks: weights across for each pixel, `weight_below` for the lower two. A pixel times kOne squared and half of
/// that fits 32 bit.
template <typename Pixel, typename Count>
inline void mix_four(const Pixel* above_left, const Pixel* above_right, const Pixel* below_left,
                     const Pixel* below_right, const std::uint16_t* weights, int weight_below, Count count,
                     Pixel* out) {
  const Wide<Pixel> below = static_cast<Wide<Pixel>>(weight_below), above = kOne - below;
#pragma omp simd
  for (int i = 0; i < count; ++i) {
    const Wide<Pixel> weight = weights[i], rest = kOne - weight;
    const Wide<Pixel> sum_above = above_left[i] * rest + above_right[i] * weight;
    const Wide<Pixel> sum_below = below_left[i] * rest + below_right[i] * weight;
    const std::uint32_t sum =
        static_cast<std::uint32_t>(sum_above) * above + static_cast<std::uint32_t>(sum_below) * below + kOne * kOne / 2;
    out[i] = static_cast<Pixel>(sum / (kOne * kOne));
  }
}

/// Calls work(count) with a constant where the usual eight pixels of one channel lie across a border: loops of known
/// length become a few instructions.
template <typename Work>
inline void with_count(int count, const Work& work) {
  if (count == 2 * kMaxMargin) {
    work(std::integral_constant<int, 2 * kMaxMargin>());
  } else {
    work(count);
  }
}

bool same_filter(const BlockFilter& a, const BlockFilter& b) {
  if (a.inverse != nullptr && b.inverse != nullptr) return true;
  if (a.inverse != b.inverse) return false;
  return a.kernel == b.kernel && (a.kernel == nullptr || a.angle_rad == b.angle_rad);
}

}  // namespace

void SeamBlender::plan(const FilterGrid& grid, int type) {
  grid_ = &grid;
  channels_ = CV_MAT_CN(type);
  const int cols = grid.cols(), rows = grid.rows();
  // A line all along which nothing changes needs no margin.
  margin_x_.assign(cols + 1, 0);
  margin_y_.assign(rows + 1, 0);
  bool some_copied = false, some_filtered = false;
  for (int row = 0; row < rows; ++row) {
    for (int col = 0; col < cols; ++col) {
      const int block = row * cols + col;
      (is_copied(block) ? some_copied : some_filtered) = true;
      if (col > 0 && !same_filter(grid.blocks[block - 1], grid.blocks[block])) {
        margin_x_[col] = margin_between(grid.x[col] - grid.x[col - 1], grid.x[col + 1] - grid.x[col]);
      }
      if (row > 0 && !same_filter(grid.blocks[block - cols], grid.blocks[block])) {
        margin_y_[row] = margin_between(grid.y[row] - grid.y[row - 1], grid.y[row + 1] - grid.y[row]);
      }
    }
  }
  const auto is_not_zero = [](int margin) { return margin != 0; };
  blends_ = some_filtered && (std::any_of(margin_x_.begin(), margin_x_.end(), is_not_zero) ||
                              std::any_of(margin_y_.begin(), margin_y_.end(), is_not_zero));
  fades_ = blends_ && some_copied;

  const std::size_t pixel_bytes = CV_ELEM_SIZE(type);
  places_.clear();
  std::size_t total = 0;
  for (int block = 0; block < cols * rows; ++block) {
    const int col = block % cols, row = block / cols;
    places_.push_back({grid.rect(block), {margin_x_[col], margin_y_[row], margin_x_[col + 1], margin_y_[row + 1]}, {}});
    if (is_copied(block)) continue;
    for (const Strip strip : {TOP, BOTTOM, LEFT, RIGHT}) {
      places_.back().offsets[strip] = total;
      total += strip_rect(block, strip).area() * pixel_bytes;
    }
    total = (total + kCacheLineBytes - 1) / kCacheLineBytes * kCacheLineBytes;
  }
  if (results_.size() < total) results_.resize(total);
}

cv::Rect SeamBlender::reach(int block) const {
  const auto& [rect, m, offsets] = places_[block];
  return {rect.x - m.left, rect.y - m.top, rect.width + m.left + m.right, rect.height + m.top + m.bottom};
}

cv::Rect SeamBlender::strip_rect(int block, Strip strip) const {
  const auto& [rect, m, offsets] = places_[block];
  const cv::Rect whole = reach(block);
  // The upper and the lower strip have the corners.
  const int inner_y = rect.y + m.top, inner_height = rect.height - m.top - m.bottom;
  switch (strip) {
    case TOP:
      return {whole.x, whole.y, whole.width, 2 * m.top};
    case BOTTOM:
      return {whole.x, rect.br().y - m.bottom, whole.width, 2 * m.bottom};
    case LEFT:
      return {whole.x, inner_y, 2 * m.left, inner_height};
    default:
      return {rect.br().x - m.right, inner_y, 2 * m.right, inner_height};
  }
}

template <typename Pixel>
std::array<SeamBlender::Part<Pixel>, 5> SeamBlender::parts(int block, cv::Mat& dst) {
  const auto& [rect, m, offsets] = places_[block];
  const cv::Rect inner(rect.x + m.left, rect.y + m.top, rect.width - m.left - m.right, rect.height - m.top - m.bottom);
  std::array<Part<Pixel>, 5> parts;
  parts[0] = {inner, inner.empty() ? nullptr : dst.ptr<Pixel>(inner.y, inner.x),
              static_cast<std::ptrdiff_t>(dst.step1())};
  for (const Strip strip : {TOP, BOTTOM, LEFT, RIGHT}) {
    const cv::Rect of_strip = strip_rect(block, strip);
    parts[1 + strip] = {of_strip, reinterpret_cast<Pixel*>(results_.data() + offsets[strip]),
                        static_cast<std::ptrdiff_t>(of_strip.width) * channels_};
  }
  return parts;
}

template std::array<SeamBlender::Part<std::uint8_t>, 5> SeamBlender::parts(int, cv::Mat&);
template std::array<SeamBlender::Part<std::uint16_t>, 5> SeamBlender::parts(int, cv::Mat&);

void SeamBlender::store(int block, const cv::Mat& result, cv::Mat& dst, int channel) {
  const auto store_in = [&](const auto& parts) {
    for (const auto& part : parts) {
      if (part.rect.empty()) continue;  // has no place in memory either
      const cv::Mat from = result(part.rect - reach(block).tl());
      cv::Mat to(part.rect.size(), dst.type(), part.to, part.stride * sizeof *part.to);
      if (from.channels() == channels_) {
        from.copyTo(to);
      } else {
        cv::insertChannel(from, to, channel);
      }
    }
  };
  if (dst.depth() == CV_8U) {
    store_in(parts<std::uint8_t>(block, dst));
  } else {
    store_in(parts<std::uint16_t>(block, dst));
  }
}

/// What `block` has at (x, y), which lies in `strip`, and beyond.
template <typename Pixel>
SeamBlender::View<Pixel> SeamBlender::view(int block, Strip strip, int x, int y, const cv::Mat& src) const {
  if (is_copied(block)) return {src.ptr<Pixel>(y, x), static_cast<std::ptrdiff_t>(src.step1())};
  const Pixel* from = reinterpret_cast<const Pixel*>(results_.data() + places_[block].offsets[strip]);
  const cv::Rect rect = strip_rect(block, strip);
  const std::ptrdiff_t stride = static_cast<std::ptrdiff_t>(rect.width) * channels_;
  return {from + (y - rect.y) * stride + static_cast<std::ptrdiff_t>(x - rect.x) * channels_, stride};
}

/// The border between a block and the one to its right, without the corners.
template <typename Pixel>
void SeamBlender::blend_right(int block, const cv::Mat& src, cv::Mat& dst) const {
  const bool left_copied = is_copied(block), right_copied = is_copied(block + 1);
  if (left_copied && right_copied) return;
  const cv::Rect rect = strip_rect(block, RIGHT);
  if (rect.empty()) return;
  const int margin = rect.width / 2;
  const View<Pixel> left = view<Pixel>(block, RIGHT, rect.x, rect.y, src);
  const View<Pixel> right = view<Pixel>(block + 1, LEFT, rect.x, rect.y, src);
  const Ramp ramp = border_ramp(margin, channels_);
  const int first = left_copied ? margin * channels_ : 0;
  const int count = (left_copied || right_copied ? margin : 2 * margin) * channels_;
  with_count(count, [&](auto known) {
    for (int y = 0; y < rect.height; ++y) {
      mix(left.at + y * left.stride + first, right.at + y * right.stride + first, ramp.weights + first, known,
          dst.ptr<Pixel>(rect.y + y, rect.x) + first);
    }
  });
}

/// The border between a block and the one below it, without the corners.
template <typename Pixel>
void SeamBlender::blend_below(int block, const cv::Mat& src, cv::Mat& dst) const {
  const int below = block + grid_->cols();
  const bool upper_copied = is_copied(block), lower_copied = is_copied(below);
  if (upper_copied && lower_copied) return;
  const auto& [rect, m, offsets] = places_[block];
  const int x = rect.x + m.left, count = (rect.width - m.left - m.right) * channels_;
  const int y0 = rect.br().y - m.bottom;
  const View<Pixel> upper = view<Pixel>(block, BOTTOM, x, y0, src), lower = view<Pixel>(below, TOP, x, y0, src);
  for (int i = upper_copied ? m.bottom : 0; i < (lower_copied ? m.bottom : 2 * m.bottom); ++i) {
    mix(upper.at + i * upper.stride, lower.at + i * lower.stride, ramp_weight(m.bottom, i), count,
        dst.ptr<Pixel>(y0 + i, x));
  }
}

/// Where a block meets three others, to its right and below.
template <typename Pixel>
void SeamBlender::blend_corner(int block, const cv::Mat& src, cv::Mat& dst) const {
  const int cols = grid_->cols();
  const int owners[2][2] = {{block, block + 1}, {block + cols, block + cols + 1}};
  const Margins& m = places_[block].margins;
  const cv::Point corner = places_[block].rect.br() - cv::Point(m.right, m.bottom);
  View<Pixel> views[2][2];
  bool all_filtered = true;
  for (int row = 0; row < 2; ++row) {
    for (int col = 0; col < 2; ++col) {
      views[row][col] = view<Pixel>(owners[row][col], row == 0 ? BOTTOM : TOP, corner.x, corner.y, src);
      all_filtered = all_filtered && !is_copied(owners[row][col]);
    }
  }
  const Ramp ramp = border_ramp(m.right, channels_);
  const auto blend_part = [&](int first_row, int end_row, int first, int count) {
    with_count(count, [&](auto known) {
      for (int i = first_row; i < end_row; ++i) {
        const auto from = [&](const View<Pixel>& view) { return view.at + i * view.stride + first; };
        mix_four(from(views[0][0]), from(views[0][1]), from(views[1][0]), from(views[1][1]), ramp.weights + first,
                 ramp_weight(m.bottom, i), known, dst.ptr<Pixel>(corner.y + i, corner.x) + first);
      }
    });
  };
  if (all_filtered) return blend_part(0, 2 * m.bottom, 0, 2 * m.right * channels_);
  const int count = m.right * channels_;
  for (int row = 0; row < 2; ++row) {
    for (int col = 0; col < 2; ++col) {
      if (is_copied(owners[row][col])) continue;
      blend_part(row * m.bottom, (row + 1) * m.bottom, col * count, count);
    }
  }
}

/// Fades a filtered block into the input towards the copied ones around it.
template <typename Pixel>
void SeamBlender::fade(int block, const cv::Mat& src, cv::Mat& dst) const {
  const int cols = grid_->cols(), col = block % cols, row = block / cols;
  const auto copied = [&](int dx, int dy) {
    const bool inside = col + dx >= 0 && col + dx < cols && row + dy >= 0 && row + dy < grid_->rows();
    return inside && is_copied(block + dy * cols + dx);
  };
  const auto& [rect, m, offsets] = places_[block];
  // Begin and end of the parts before, between and behind the margins.
  const int xs[] = {rect.x, rect.x + m.left, rect.br().x - m.right, rect.br().x};
  const int ys[] = {rect.y, rect.y + m.top, rect.br().y - m.bottom, rect.br().y};
  for (int dy = -1; dy <= 1; ++dy) {
    for (int dx = -1; dx <= 1; ++dx) {
      const bool sideways = dx != 0 && copied(dx, 0), above = dy != 0 && copied(0, dy), across = copied(dx, dy);
      if (!(sideways || above || across) || (dx == 0 && dy == 0)) continue;
      const int x0 = xs[dx + 1], x1 = xs[dx + 2];
      for (int y = ys[dy + 1]; y < ys[dy + 2]; ++y) {
        const int of_y = dy == 0  ? kOne
                         : dy < 0 ? fade_weight(m.top, y - rect.y)
                                  : fade_weight(m.bottom, rect.br().y - 1 - y);
        const Pixel* from = src.ptr<Pixel>(y, x0);
        Pixel* to = dst.ptr<Pixel>(y, x0);
        const int count = (x1 - x0) * channels_;
        if (dx == 0) {
          mix(to, from, of_y, count, to);
          continue;
        }
        Ramp ramp;
        for (int i = 0; i < count; ++i) {
          const int x = x0 + i / channels_;
          const int of_x = dx < 0 ? fade_weight(m.left, x - rect.x) : fade_weight(m.right, rect.br().x - 1 - x);
          const int weight = std::max({sideways ? of_x : 0, above ? of_y : 0, across ? std::min(of_x, of_y) : 0});
          ramp.weights[i] = static_cast<std::uint16_t>(weight);
        }
        mix(to, from, ramp.weights, count, to);
      }
    }
  }
}

template <typename Pixel>
void SeamBlender::blend_as(const cv::Mat& src, int threads, cv::Mat& dst) const {
  const int cols = grid_->cols(), count = cols * grid_->rows();
  constexpr int kBlocksAtATime = 16;
  parallel_for(count, threads, kBlocksAtATime, [&](int block) {
    const Margins& m = places_[block].margins;
    if (m.right > 0) blend_right<Pixel>(block, src, dst);
    if (m.bottom > 0) blend_below<Pixel>(block, src, dst);
    if (m.right > 0 && m.bottom > 0) blend_corner<Pixel>(block, src, dst);
  });
  if (!fades_) return;
  parallel_for(count, threads, kBlocksAtATime, [&](int block) {
    if (!is_copied(block)) fade<Pixel>(block, src, dst);
  });
}

void SeamBlender::blend(const cv::Mat& src, int threads, cv::Mat& dst) const {
  if (!blends_) return;
  if (src.depth() == CV_8U) {
    blend_as<std::uint8_t>(src, threads, dst);
  } else {
    blend_as<std::uint16_t>(src, threads, dst);
  }
}

}  // namespace gyro_deblur
