// Where a patch of one blurred image is in another that is blurred differently.
#pragma once

#include <optional>
#include <utility>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "blur/path_2d.hpp"
#include "features/alignment_simd.hpp"

namespace gyro_deblur {

/// Path of a point that stands still. Eigen's default constructor sets nothing.
inline Path2d still_path() {
  Path2d path_px;
  path_px.fill(Eigen::Vector2f::Zero());
  return path_px;
}

/// Standard deviation of the noise that rounding to whole grey levels makes: 1 / sqrt(12).
constexpr double kRoundingNoise = 0.29;

/// A scene point in a blurred image.
struct BlurredPoint {
  Eigen::Vector2d place_px;       ///< where it is at the middle of its exposure
  Path2d path_px = still_path();  ///< during the exposure, relative to place_px
  double noise = 0;               ///< >= 0: standard deviation of the image's pixels [grey levels], rounding included
};

struct AlignmentOptions {
  int window_px = 21;         ///< odd, [5, 101]: side of the patch that is compared, in the second image
  int max_iterations = 30;    ///< >= 1
  double max_offset_px = 6;   ///< > 0: the search ends farther from its start
  double min_step_px = 0.02;  ///< > 0: a shorter step ends the search
};

/// A point that was found in the second image.
struct Alignment {
  Eigen::Vector2d place_px;        ///< where it is at the middle of its exposure
  Eigen::Matrix2d covariance_px2;  ///< of place_px: noise of both images, scaled up where the residual is larger
  double gain;                     ///< contrast of the second patch over that of the first, noise apart
  double contrast;                 ///< standard deviation of the compared patch without noise [second image's levels]
  double residual;                 ///< root mean square of the difference of the patches [same]
  double expected_residual;        ///< residual that the noise of both images causes [same]
};

/// The same point in the image at half the size, whose pixels are means of 2 x 2: the noise of a pixel is white.
BlurredPoint at_half_size(BlurredPoint point);
/// What was found at half the size, in pixels of the whole.
Alignment at_whole_size(Alignment found);

/// Whether the two patches differ by no more than noise and what a motion that is not affine makes, at a similar
/// contrast.
bool agrees(const Alignment& alignment);

/// Finds points by inverse compositional Lucas-Kanade (S. Baker, I. Matthews, IJCV 2004) with gain and offset, after
/// each patch has been blurred by the path of the other (doc/design/tracks.md). Nothing is deconvolved.
///
/// Keeps its buffers from call to call. Not thread-safe.
class BlurAligner {
 public:
  /// @param from, to  CV_8UC1, raw: neither deblurred nor equalised
  /// @param map       Jacobian of the motion from `from` to `to` at the point
  /// @param in_to     place_px: start of the search
  /// @return nothing where the search ends outside the images or max_offset_px, does not converge, or where the blurred
  ///         template has no texture in one direction. A window that is cut by the image's edge, blur included, is
  ///         compared where it is complete, down to 40 % of it.
  std::optional<Alignment> align(const cv::Mat& from, const BlurredPoint& in_from, const cv::Mat& to,
                                 const BlurredPoint& in_to, const Eigen::Matrix2d& map,
                                 const AlignmentOptions& options);

 private:
  using Pixels = Eigen::Array<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

  /// Pixels with room behind each row (alignment_simd.hpp).
  class Patch {
   public:
    /// All pixels are 0, unless it had this size. The room behind each row is 0, as long as only 0 has been written
    /// there.
    void resize(int width, int height);
    int width() const { return width_; }
    int height() const { return height_; }
    int size() const { return width_ * height_; }
    int stride() const { return stride_; }
    float* row(int y) { return pixels_.data() + y * stride_; }
    const float* row(int y) const { return pixels_.data() + y * stride_; }

   private:
    int width_ = 0, height_ = 0, stride_ = 0;
    std::vector<float> pixels_;
  };

  /// Pixels, both ends included.
  struct Box {
    int first_x = 0, last_x = -1, first_y = 0, last_y = -1;
    int width() const { return last_x - first_x + 1; }
    int height() const { return last_y - first_y + 1; }
    Box grown(const Box& by) const {
      return {first_x + by.first_x, last_x + by.last_x, first_y + by.first_y, last_y + by.last_y};
    }
    bool contains(const Box& other) const {
      return other.first_x >= first_x && other.last_x <= last_x && other.first_y >= first_y && other.last_y <= last_y;
    }
  };
  /// PSF of a path: the pixels that are read for one that is written.
  struct Psf {
    Pixels shares;     // sums to 1
    Box reach;         // of `shares`, relative to the written pixel
    float energy = 0;  // sum of the squared shares
  };
  /// Part of an image, blurred.
  struct Region {
    Patch patch;
    Box box;
  };

  static void rasterize(const Path2d& path_px, Psf* psf);
  void blur(const cv::Mat& image, const Psf& psf, const Box& box, Region* blurred);
  /// Shrinks window_ until everything that is read lies in the images; false where too little of it is left.
  bool crop_window(const cv::Size& from, const Eigen::Vector2d& from_px, const cv::Size& to,
                   const Eigen::Vector2d& to_px, const Eigen::Matrix2d& inverse_map, int window_px);
  Box template_box(const Eigen::Vector2d& place_px, const Eigen::Matrix2d& inverse_map) const;
  Box search_box(const Eigen::Vector2d& place_px, int margin_px) const;
  /// Makes template_, gradient_x_ and gradient_y_.
  void sample_template(const Eigen::Vector2d& place_px, const Eigen::Matrix2d& inverse_map);
  /// Sum of the squares of template_ without those of its noise, which bias a gain by them towards 0.
  double pattern_energy(double noise_variance);
  /// Takes out of the gradients what gain and offset can explain: these are fitted with the place, not after it.
  /// @return sums of the products of what is left of them
  Eigen::Matrix2d gradients_without_gain(double pattern);
  /// Root mean square of what template_ and patch_ differ by.
  double residual(double gain);
  /// Searches from *place_px; on success patch_ is what the second image shows there, with a margin for derivatives.
  bool search(const cv::Mat& to, const Eigen::Matrix2d& gradients, double pattern, const AlignmentOptions& options,
              Eigen::Vector2d* place_px, double* gain);
  void sample_patch(const Eigen::Vector2d& place_px);
  /// Products of the gradients of template_ and patch_, summed up: their noise is independent, and not in the mean.
  Eigen::Matrix2d multiply_gradients_of_both();
  /// What white noise of variance 1, blurred by a path, makes.
  struct NoiseShare {
    Eigen::Matrix2d products = Eigen::Matrix2d::Zero();  // covariance of its products with the gradients
    double mean = 0;                                     // variance of the patch's mean
  };
  NoiseShare noise_share(const Path2d& path_px);

  Psf psf_of_first_, psf_of_second_;  // what first and second image are blurred by: the other's path
  Region first_, second_;
  Box window_;  // about the point, in the second image
  Patch source_, sampled_, rows_, template_, gradient_x_, gradient_y_, patch_, difference_;
  std::vector<int> offsets_;  // of what is not 0 in a PSF
  std::vector<float> shares_;
  std::vector<int> pairs_;                 // of a path's instants, by lag; 0 between calls
  std::vector<std::pair<int, int>> lags_;  // that have pairs
  const AlignmentSimd& simd_ = select_for_cpu<AlignmentSimd>();
};

}  // namespace gyro_deblur
