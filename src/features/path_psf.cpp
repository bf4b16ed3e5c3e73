// Draws paths into pixels.
#include "features/path_psf.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>
#include <utility>

namespace gyro_deblur {
namespace {

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
    const Eigen::Array2f begin = -path_px[k].array() - origin_px, step = (path_px[k] - path_px[k + 1]).array();
    const int samples = std::max(1, static_cast<int>(std::ceil(step.matrix().norm() / kStepPx)));
    const float share = 1.0f / static_cast<float>(samples * (kPathInstants - 1));
    for (int i = 0; i < samples; ++i) {
      add(begin + (static_cast<float>(i) + 0.5f) / static_cast<float>(samples) * step, share);
    }
  }
}

/// A place between two pixels of a row of `size`: the first, and the share of the second.
struct PixelShare {
  PixelShare(float at, Eigen::Index size)
      : first(std::clamp(static_cast<Eigen::Index>(at), Eigen::Index{0}, size - 2)),
        share(at - static_cast<float>(first)) {}
  Eigen::Index first;
  float share;
};

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
  auto& shares = psf->shares;
  shares.setZero(psf->reach.height(), psf->reach.width());
  const std::optional<int> main = main_axis(path_px);
  if (!main) {
    for_each_sample(path_px, first, [&](const Eigen::Array2f& at, float share) {
      const PixelShare x(at.x(), shares.cols()), y(at.y(), shares.rows());
      shares(y.first, x.first) += share * (1 - x.share) * (1 - y.share);
      shares(y.first, x.first + 1) += share * x.share * (1 - y.share);
      shares(y.first + 1, x.first) += share * (1 - x.share) * y.share;
      shares(y.first + 1, x.first + 1) += share * x.share * y.share;
    });
  } else {
    // Each line across the path collects its share, and that times the place.
    const int along = *main, across = 1 - along;
    const Eigen::Index lines = along == 0 ? shares.cols() : shares.rows(), size = shares.size() / lines;
    std::array<float, static_cast<std::size_t>(kMax2dExtentPx) + 3> share_of{}, moment_of{};
    for_each_sample(path_px, first, [&](const Eigen::Array2f& at, float share) {
      const PixelShare line(at[along], lines);
      for (const auto& [k, part] :
           {std::pair(line.first, share * (1 - line.share)), std::pair(line.first + 1, share * line.share)}) {
        share_of[static_cast<std::size_t>(k)] += part;
        moment_of[static_cast<std::size_t>(k)] += part * at[across];
      }
    });
    const auto at = [&](Eigen::Index line, Eigen::Index place) -> float& {
      return along == 0 ? shares(place, line) : shares(line, place);
    };
    for (Eigen::Index k = 0; k < lines; ++k) {
      const float share = share_of[static_cast<std::size_t>(k)];
      if (!(share > 0)) continue;
      const PixelShare place(moment_of[static_cast<std::size_t>(k)] / share, size);
      at(k, place.first) = share * (1 - place.share);
      at(k, place.first + 1) = share * place.share;
    }
  }
  psf->energy = shares.square().sum();
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
