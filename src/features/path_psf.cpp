// Draws paths into pixels.
#include "features/path_psf.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>
#include <utility>

namespace gyro_deblur {
namespace {

/// Of a line or a pixel: less is what rounding left.
constexpr float kLeastPixelShare = 1e-6f;

/// The axis, 0 or 1, along which each step goes forward, and at least as far as along the other; nothing if neither is.
std::optional<int> main_axis(const Path2d& path_px) {
  const Eigen::Vector2f chord_px = path_px.back() - path_px.front();
  const int axis = std::abs(chord_px.x()) > std::abs(chord_px.y()) ? 0 : 1;
  for (std::size_t k = 0; k + 1 < path_px.size(); ++k) {
    const Eigen::Vector2f step_px = path_px[k + 1] - path_px[k];
    if (!(step_px[axis] * chord_px[axis] > 0) || std::abs(step_px[1 - axis]) > std::abs(step_px[axis]))
      return std::nullopt;
  }
  return axis;
}

/// Calls add(place, share) for samples of the path half a pixel apart, which spread evenly over its pixels. A pixel
/// collects light from where the path comes from: places are mirrored.
template <typename Add>
void for_each_sample(const Path2d& path_px, const Eigen::Array2f& origin_px, Add&& add) {
  constexpr float kStepPx = 0.5f;
  for (std::size_t k = 0; k + 1 < path_px.size(); ++k) {
    const Eigen::Array2f segment = (path_px[k] - path_px[k + 1]).array();
    const int samples = std::max(1, static_cast<int>(std::ceil(segment.matrix().norm() / kStepPx)));
    const float share = 1.0f / static_cast<float>(samples * (kPathInstants - 1));
    const Eigen::Array2f step = segment / static_cast<float>(samples),
                         begin = -path_px[k].array() - origin_px + 0.5f * step;
    for (int i = 0; i < samples; ++i) add(begin + static_cast<float>(i) * step, share);
  }
}

/// A place between two pixels of a row of `size`: the first, and the share of the second.
struct PixelShare {
  PixelShare(float at, int size)
      : first(std::clamp(static_cast<int>(at), 0, size - 2)),
        share(std::clamp(at - static_cast<float>(first), 0.0f, 1.0f)) {}
  int first;
  float share;
};

/// What a line across the path collects: its share, and that times the place along the line.
struct LineShare {
  float share, moment;
};

/// Adds what a straight step gives to the two lines that each of its places is between.
/// @param from, to        places across the lines, in any order
/// @param at_from, at_to  places along the lines
void add_step(float from, float to, float at_from, float at_to, int lines, LineShare* all) {
  constexpr float kShare = 1.0f / (kPathInstants - 1);
  if (from > to) {
    std::swap(from, to);
    std::swap(at_from, at_to);
  }
  const float length = to - from, slope = length > 0 ? (at_to - at_from) / length : 0;
  float begin = from;
  do {
    const int first = std::min(static_cast<int>(begin), lines - 2);
    const float end = std::min(to, static_cast<float>(first + 1)), width = end - begin, middle = 0.5f * (begin + end),
                share = length > 0 ? kShare * width / length : kShare, at = at_from + slope * (middle - from);
    // The share of the second line grows from `begin` to `end`, as the place does.
    const float of_second = middle - static_cast<float>(first), second = share * of_second,
                second_moment = share * (of_second * at + slope * width * width / 12);
    all[first].share += share - second;
    all[first].moment += share * at - second_moment;
    all[first + 1].share += second;
    all[first + 1].moment += second_moment;
    begin = end;
  } while (begin < to);
}

/// @param origin_px  of the PSF's first pixel
/// @param size       of the PSF
void draw_lines(const Path2d& path_px, int along, const Eigen::Array2f& origin_px, const std::array<int, 2>& size,
                std::vector<PathPair>* pairs) {
  const int across = 1 - along, lines = size[static_cast<std::size_t>(along)];
  std::array<LineShare, static_cast<std::size_t>(kMax2dExtentPx) + 3> all;
  std::fill_n(all.begin(), lines, LineShare{0, 0});
  for (std::size_t k = 0; k + 1 < path_px.size(); ++k) {
    const Eigen::Array2f from = -path_px[k].array() - origin_px, to = -path_px[k + 1].array() - origin_px;
    add_step(from[along], to[along], from[across], to[across], lines, all.data());
  }
  for (int k = 0; k < lines; ++k) {
    const LineShare& line = all[static_cast<std::size_t>(k)];
    if (!(line.share > kLeastPixelShare)) continue;
    const PixelShare place(line.moment / line.share, size[static_cast<std::size_t>(across)]);
    const float second = line.share * place.share, first = line.share - second;
    pairs->push_back(along == 0 ? PathPair{k, place.first, first, second} : PathPair{place.first, k, first, second});
  }
}

/// Each sample has four pixels. The arguments are those of draw_lines().
void draw_samples(const Path2d& path_px, int along, const Eigen::Array2f& origin_px, const std::array<int, 2>& size,
                  std::vector<PathPair>* pairs) {
  Eigen::ArrayXXf shares = Eigen::ArrayXXf::Zero(size[0], size[1]);
  for_each_sample(path_px, origin_px, [&](const Eigen::Array2f& at, float share) {
    const PixelShare x(at.x(), size[0]), y(at.y(), size[1]);
    shares(x.first, y.first) += share * (1 - x.share) * (1 - y.share);
    shares(x.first + 1, y.first) += share * x.share * (1 - y.share);
    shares(x.first, y.first + 1) += share * (1 - x.share) * y.share;
    shares(x.first + 1, y.first + 1) += share * x.share * y.share;
  });
  const int lines = size[static_cast<std::size_t>(along)], places = size[static_cast<std::size_t>(1 - along)];
  for (int k = 0; k < lines; ++k) {
    const auto share_at = [&](int place) -> float& { return along == 0 ? shares(k, place) : shares(place, k); };
    for (int place = 0; place < places; ++place) {
      if (!(share_at(place) > kLeastPixelShare)) continue;
      const int first = std::min(place, places - 2);  // the last pixel has no next one
      if (first < place) share_at(first) = 0;
      pairs->push_back(along == 0 ? PathPair{k, first, share_at(first), share_at(first + 1)}
                                  : PathPair{first, k, share_at(first), share_at(first + 1)});
      place = first + 1;
    }
  }
}

}  // namespace

void rasterize(const Path2d& path_px, PathPsf* psf) {
  Eigen::Array2f least = path_px[0], most = path_px[0];
  for (const Eigen::Vector2f& place_px : path_px) {
    least = least.min(place_px.array());
    most = most.max(place_px.array());
  }
  const Eigen::Array2f first = (-most).floor(), last = (-least).floor() + 1;
  psf->reach = {static_cast<int>(first.x()), static_cast<int>(last.x()), static_cast<int>(first.y()),
                static_cast<int>(last.y())};
  const std::array<int, 2> size{psf->reach.width(), psf->reach.height()};
  psf->pairs.clear();
  const std::optional<int> main = main_axis(path_px);
  if (main) {
    draw_lines(path_px, *main, first, size, &psf->pairs);
    psf->axis = 1 - *main;
  } else {
    psf->axis = size[0] > size[1] ? 1 : 0;
    draw_samples(path_px, 1 - psf->axis, first, size, &psf->pairs);
  }
  psf->energy = 0;
  for (const PathPair& pair : psf->pairs) psf->energy += pair.first * pair.first + pair.second * pair.second;
}

void find_noise_lags(const Path2d& path_px, const std::array<int, 2>& spacing, std::vector<NoiseLag>* lags) {
  constexpr int kSteps = kPathInstants - 1;  // each stands for the same time
  Eigen::Vector2f mean_px = Eigen::Vector2f::Zero();
  for (std::size_t k = 0; k < kSteps; ++k) mean_px += 0.5f / kSteps * (path_px[k] + path_px[k + 1]);
  Eigen::Matrix2f variance_px2 = Eigen::Matrix2f::Zero();
  for (std::size_t k = 0; k < kSteps; ++k) {
    const Eigen::Vector2f away_px = 0.5f * (path_px[k] + path_px[k + 1]) - mean_px;
    variance_px2 += 1.0f / kSteps * away_px * away_px.transpose();
  }
  const int along = variance_px2(0, 0) > variance_px2(1, 1) ? 0 : 1, across = 1 - along;
  const float variance = variance_px2(along, along), slope = variance > 0 ? variance_px2(along, across) / variance : 0,
              length_px = std::max(1.0f, std::sqrt(12 * variance));  // of a uniform distribution
  const auto step_px = static_cast<float>(spacing[static_cast<std::size_t>(along)]),
             step_across_px = static_cast<float>(spacing[static_cast<std::size_t>(across)]);
  lags->clear();
  for (int lag = 0; step_px * static_cast<float>(lag) < length_px; ++lag) {
    const float away_px = step_px * static_cast<float>(lag), aside_px = slope * away_px;
    const int aside = static_cast<int>(std::floor(aside_px / step_across_px + 0.5f));
    // Pixels with a spacing across the path meet it only now and then.
    const float met =
        step_across_px > 1 ? std::max(0.0f, 1 - std::abs(aside_px - step_across_px * static_cast<float>(aside))) : 1;
    if (!(met > 0)) continue;
    const float correlation = met * (lag == 0 ? 1 : 2) * (1 - away_px / length_px) / length_px;
    if (along == 1) {
      lags->push_back({aside, lag, correlation});
    } else if (aside >= 0) {
      lags->push_back({lag, aside, correlation});
    } else {
      lags->push_back({-lag, -aside, correlation});
    }
  }
}

}  // namespace gyro_deblur
