// Renders images with rolling shutter and motion blur.
#include "sim/renderer.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <opencv2/imgproc.hpp>

#include "base/parallel.hpp"

namespace gyro_deblur::sim {
namespace {

// Texel coordinates and inverse depth of the rays of one row on one plane, for one pose:
// inverse depth = w . (x, y, 1), u = cu + a . (x, y, 1) * depth, v = cv + b . (x, y, 1) * depth.
struct PlaneMap {
  float w[3], a[3], b[3];
  float cu, cv;
};

// Everything that a row needs, without its result.
struct RowScratch {
  explicit RowScratch(int width, int channels)
      : inverse_depth(static_cast<std::size_t>(width)),
        fu(inverse_depth),
        fv(inverse_depth),
        value(static_cast<std::size_t>(width) * static_cast<std::size_t>(channels)),
        index(static_cast<std::size_t>(width)) {}
  std::vector<float> inverse_depth, fu, fv, value;
  std::vector<int> index;  // of the upper left texel; -1: nothing nearer was hit
};

// Finds texels and marks pixels that see this plane nearer than anything before. Returns whether there are any.
bool locate(const float* ray_x, const float* ray_y, int width, const PlaneMap map, const cv::Mat& level,
            RowScratch& row) {
  const float u_last = static_cast<float>(level.cols - 1), v_last = static_cast<float>(level.rows - 1);
  // Just below the last texel, so that the right and lower neighbours exist.
  const float u_max = std::nextafter(u_last, 0.0f), v_max = std::nextafter(v_last, 0.0f);
  const float u_end = u_last + 0.5f, v_end = v_last + 0.5f;
  const int stride = level.cols;
  float* inverse_depth = row.inverse_depth.data();
  float* fu = row.fu.data();
  float* fv = row.fv.data();
  int* index = row.index.data();
  int hits = 0;
#pragma omp simd reduction(| : hits)
  for (int i = 0; i < width; ++i) {
    const float x = ray_x[i], y = ray_y[i];
    const float inverse = map.w[0] * x + map.w[1] * y + map.w[2];
    const float depth = 1.0f / inverse;
    const float u = map.cu + (map.a[0] * x + map.a[1] * y + map.a[2]) * depth;
    const float v = map.cv + (map.b[0] * x + map.b[1] * y + map.b[2]) * depth;
    // Bitwise, and clamped whether hit or not: no branches, so that the loop vectorises. NaN rays compare false.
    const float nearest = inverse_depth[i];
    const int hit = -static_cast<int>((inverse > nearest) & (u >= -0.5f) & (u <= u_end) & (v >= -0.5f) & (v <= v_end));
    const float u_floored = u > 0.0f ? u : 0.0f, v_floored = v > 0.0f ? v : 0.0f;
    const float u_inside = u_floored < u_max ? u_floored : u_max, v_inside = v_floored < v_max ? v_floored : v_max;
    const int iu = static_cast<int>(u_inside), iv = static_cast<int>(v_inside);
    fu[i] = u_inside - static_cast<float>(iu);
    fv[i] = v_inside - static_cast<float>(iv);
    index[i] = (iv * stride + iu) | ~hit;  // -1 without a hit
    inverse_depth[i] = hit != 0 ? inverse : nearest;
    hits |= hit;
  }
  return hits != 0;
}

template <int kChannels>
void sample(int width, const cv::Mat& level, RowScratch& row) {
  const float* texels = level.ptr<float>();
  const std::ptrdiff_t below = static_cast<std::ptrdiff_t>(level.cols) * kChannels;
  const float* fu = row.fu.data();
  const float* fv = row.fv.data();
  const int* index = row.index.data();
  float* value = row.value.data();
  for (int i = 0; i < width; ++i, value += kChannels) {
    if (index[i] < 0) continue;
    const float u = fu[i], v = fv[i];
    const float* p = texels + static_cast<std::ptrdiff_t>(index[i]) * kChannels;
    for (int c = 0; c < kChannels; ++c) {
      const float top = p[c] + u * (p[c + kChannels] - p[c]);
      const float bottom = p[c + below] + u * (p[c + below + kChannels] - p[c + below]);
      value[c] = top + v * (bottom - top);
    }
  }
}

}  // namespace

Renderer::Renderer(const Camera& camera, const std::vector<Plane>& planes, double background, int channels)
    : width_px_(camera.calibration().width_px),
      height_px_(camera.calibration().height_px),
      channels_(channels),
      background_(static_cast<float>(background)) {
  std::vector<Eigen::Vector2d> pixels;
  pixels.reserve(static_cast<std::size_t>(width_px_) * static_cast<std::size_t>(height_px_));
  for (int y = 0; y < height_px_; ++y) {
    for (int x = 0; x < width_px_; ++x) pixels.emplace_back(x, y);
  }
  for (const Eigen::Vector3d& ray : camera.rays(pixels)) {
    ray_x_.push_back(static_cast<float>(ray.x()));
    ray_y_.push_back(static_cast<float>(ray.y()));
  }
  for (const Plane& plane : planes) {
    cv::Mat texture = plane.texture;
    if (texture.channels() != channels) {
      cv::cvtColor(plane.texture, texture, channels == 1 ? cv::COLOR_BGR2GRAY : cv::COLOR_GRAY2BGR);
    }
    surfaces_.push_back(
        {Texture(texture), plane.width_m, plane.height_m, plane.R_world_plane.conjugate(), plane.center_m});
  }
}

cv::Mat Renderer::render(const std::function<RowPoses(int row)>& poses) {
  std::vector<RowPoses> rows(static_cast<std::size_t>(height_px_));
  constexpr int kDefaultThreads = 0, kRowsAtATime = 4;
  parallel_for(height_px_, kDefaultThreads, kRowsAtATime, [&](int y) { rows[static_cast<std::size_t>(y)] = poses(y); });

  // Levels are built before the parallel part: Texture is not thread-safe.
  std::vector<std::vector<const cv::Mat*>> levels(rows.size());
  for (std::size_t y = 0; y < rows.size(); ++y) {
    for (Surface& surface : surfaces_) {
      levels[y].push_back(&surface.texture.level(level_of(surface, rows[y].middle, static_cast<int>(y))));
    }
  }

  cv::Mat image(height_px_, width_px_, CV_32FC(channels_));
  parallel_for(height_px_, kDefaultThreads, kRowsAtATime, [&](int y) {
    const std::size_t row = static_cast<std::size_t>(y);
    if (channels_ == 1) {
      render_row<1>(rows[row].samples, y, levels[row], image.ptr<float>(y));
    } else {
      render_row<3>(rows[row].samples, y, levels[row], image.ptr<float>(y));
    }
  });
  return image;
}

template <int kChannels>
void Renderer::render_row(const std::vector<Pose>& samples, int row, const std::vector<const cv::Mat*>& levels,
                          float* out) const {
  const float* ray_x = ray_x_.data() + static_cast<std::ptrdiff_t>(row) * width_px_;
  const float* ray_y = ray_y_.data() + static_cast<std::ptrdiff_t>(row) * width_px_;
  const int values = width_px_ * kChannels;
  RowScratch scratch(width_px_, kChannels);
  std::fill(out, out + values, 0.0f);
  for (const Pose& pose : samples) {
    std::fill(scratch.inverse_depth.begin(), scratch.inverse_depth.end(), 0.0f);  // the background is infinitely far
    std::fill(scratch.value.begin(), scratch.value.end(), background_);
    for (std::size_t k = 0; k < surfaces_.size(); ++k) {
      const Surface& s = surfaces_[k];
      const Eigen::Vector3d c = s.R_plane_world * (pose.p_world_m - s.center_m);
      const Eigen::Matrix3d R = (s.R_plane_world * pose.R_world_cam).toRotationMatrix();
      if (c.z() == 0) continue;  // the camera is in the plane and sees it edge-on
      const cv::Mat& level = *levels[k];
      const double su = level.cols / s.width_m, sv = level.rows / s.height_m;  // [texels/m]
      PlaneMap map;
      for (int i = 0; i < 3; ++i) {
        map.w[i] = static_cast<float>(-R(2, i) / c.z());
        map.a[i] = static_cast<float>(su * R(0, i));
        map.b[i] = static_cast<float>(sv * R(1, i));
      }
      map.cu = static_cast<float>(su * c.x() + 0.5 * level.cols - 0.5);
      map.cv = static_cast<float>(sv * c.y() + 0.5 * level.rows - 0.5);
      if (locate(ray_x, ray_y, width_px_, map, level, scratch)) sample<kChannels>(width_px_, level, scratch);
    }
    const float* value = scratch.value.data();
    for (int i = 0; i < values; ++i) out[i] += value[i];
  }
  const float weight = 1.0f / static_cast<float>(samples.size());
  for (int i = 0; i < values; ++i) out[i] *= weight;
}

int Renderer::level_of(const Surface& surface, const Pose& pose, int row) const {
  constexpr int kProbes = 9;  // along the row
  const Eigen::Vector3d c = surface.R_plane_world * (pose.p_world_m - surface.center_m);
  const Eigen::Matrix3d R = (surface.R_plane_world * pose.R_world_cam).toRotationMatrix();
  const auto on_plane = [&](int x, int y) -> Eigen::Vector3d {  // x, y [m] and inverse depth
    const std::size_t i =
        static_cast<std::size_t>(y) * static_cast<std::size_t>(width_px_) + static_cast<std::size_t>(x);
    const Eigen::Vector3d d = R * Eigen::Vector3d(ray_x_[i], ray_y_[i], 1);
    const double inverse = -d.z() / c.z();
    return {c.x() + d.x() / inverse, c.y() + d.y() / inverse, inverse};
  };
  // Geometric mean of the texels a pixel, over the probes inside the plane, else over all in front.
  double log_inside = 0, log_front = 0;
  int inside = 0, front = 0;
  const int y = std::min(row, height_px_ - 2);
  for (int k = 0; k < kProbes && width_px_ > 1 && height_px_ > 1; ++k) {
    const int x = (width_px_ - 2) * k / (kProbes - 1);
    const Eigen::Vector3d p = on_plane(x, y), right = on_plane(x + 1, y) - p, down = on_plane(x, y + 1) - p;
    const double area = std::abs(right.x() * down.y() - right.y() * down.x()) * surface.texture.width_px() *
                        surface.texture.height_px() / (surface.width_m * surface.height_m);
    if (!(p.z() > 0) || !std::isfinite(area) || area <= 0) continue;
    const double texels = 0.5 * std::log(area);
    log_front += texels;
    ++front;
    if (std::abs(p.x()) <= surface.width_m / 2 && std::abs(p.y()) <= surface.height_m / 2) {
      log_inside += texels;
      ++inside;
    }
  }
  if (front == 0) return surface.texture.level_for(1);
  return surface.texture.level_for(std::exp(inside > 0 ? log_inside / inside : log_front / front));
}

std::vector<Eigen::Vector3d> Renderer::intersections(const Pose& pose, const Eigen::Vector3d& ray_cam) const {
  std::vector<std::pair<double, Eigen::Vector3d>> hits;
  const Eigen::Vector3d direction = pose.R_world_cam * ray_cam;
  for (const Surface& s : surfaces_) {
    const Eigen::Vector3d c = s.R_plane_world * (pose.p_world_m - s.center_m), d = s.R_plane_world * direction;
    const double depth = -c.z() / d.z();
    const Eigen::Vector3d p = c + depth * d;
    if (depth > 0 && std::abs(p.x()) <= s.width_m / 2 && std::abs(p.y()) <= s.height_m / 2) {
      hits.emplace_back(depth, pose.p_world_m + depth * direction);
    }
  }
  std::sort(hits.begin(), hits.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  std::vector<Eigen::Vector3d> points;
  points.reserve(hits.size());
  for (const auto& hit : hits) points.push_back(hit.second);
  return points;
}

}  // namespace gyro_deblur::sim
