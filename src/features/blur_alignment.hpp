// Where a patch of one blurred image is in another that is blurred differently.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "blur/path_2d.hpp"
#include "features/alignment_simd.hpp"
#include "features/local_map.hpp"
#include "features/path_psf.hpp"

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
  double min_step_px = 0.03;  ///< > 0: a shorter step ends the search
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
/// The same map between images at half the size.
LocalMap at_half_size(LocalMap map);
/// What was found at half the size, in pixels of the whole.
Alignment at_whole_size(Alignment found);

/// Whether the two patches differ by no more than noise and what the local map does not explain, at a similar
/// contrast.
bool agrees(const Alignment& alignment);

/// Finds points by inverse compositional Lucas-Kanade (S. Baker, I. Matthews, IJCV 2004) with gain and offset, after
/// each patch has been blurred by the path of the other (doc/design/tracks.md). Nothing is deconvolved.
///
/// Keeps its buffers from call to call. Not thread-safe.
class BlurAligner {
 public:
  /// @param from, to  CV_8UC1, raw: neither deblurred nor equalised
  /// @param map       of the neighbourhood of the point from `from` to `to`
  /// @param in_to     place_px: start of the search
  /// @return nothing where the search ends outside the images or max_offset_px, does not converge, or where the blurred
  ///         template has no texture in one direction. A window that is cut by the image's edge, blur included, is
  ///         compared where it is complete, down to 40 % of it.
  std::optional<Alignment> align(const cv::Mat& from, const BlurredPoint& in_from, const cv::Mat& to,
                                 const BlurredPoint& in_to, const LocalMap& map, const AlignmentOptions& options);

 private:
  /// Pixels with room behind each row (alignment_simd.hpp).
  class Patch {
   public:
    /// Pixels, and the room behind each row, have any finite values.
    void resize(int width, int height);
    /// The room behind each row becomes 0.
    void clear_room();
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

  /// Part of an image, blurred.
  struct Region {
    Patch patch;
    PixelBox box;
  };

  /// Chooses spacing_ by the blurs of both images, in the second image's axes.
  void choose_spacing(const Path2d& first_px, const Path2d& second_px);
  /// Takes steps between compared pixels to pixels.
  Eigen::Matrix2d px_per_compared() const { return Eigen::Vector2d(spacing_[0], spacing_[1]).asDiagonal(); }
  int compared_columns() const { return (window_.width() - 1) / spacing_[0] + 1; }
  int compared_rows() const { return (window_.height() - 1) / spacing_[1] + 1; }
  void blur(const cv::Mat& image, const PathPsf& psf, const PixelBox& box, Region* blurred);
  /// Shrinks window_ until everything that is read lies in the images; false where too little of it is left.
  bool crop_window(const cv::Size& from, const Eigen::Vector2d& from_px, const cv::Size& to,
                   const Eigen::Vector2d& to_px, const Eigen::Matrix2d& inverse_map, int window_px);
  PixelBox template_box(const Eigen::Vector2d& place_px, const Eigen::Matrix2d& inverse_map) const;
  PixelBox search_box(const Eigen::Vector2d& place_px, int margin_px) const;
  /// Makes template_, gradient_x_ and gradient_y_.
  /// @param quadratic  of the map, by offsets in the second image
  /// @return sum of the squares of template_
  double sample_template(const Eigen::Vector2d& place_px, const Eigen::Matrix2d& inverse_map,
                         const LocalMap::Quadratic& quadratic);
  /// Takes out of the gradients what gain and offset can explain: these are fitted with the place, not after it.
  /// @return sums of the products of what is left of them, for steps between compared pixels
  Eigen::Matrix2d gradients_without_gain(double pattern);
  /// Sums of the products of the gradients with those of the pixels `away_y` >= 0 rows and `away_x` columns on.
  Eigen::Matrix2d gradient_products(int away_x, int away_y);
  /// Root mean square of what template_ and patch_ differ by.
  double residual(double gain);
  /// Searches from *place_px; on success patch_ is what the second image shows there, with a margin for derivatives.
  bool search(const cv::Mat& to, const Eigen::Matrix2d& gradients, double pattern, const AlignmentOptions& options,
              Eigen::Vector2d* place_px, double* gain);
  /// Makes sorted_: the columns of second_, those that are spacing_[0] apart next to each other.
  void sort_columns();
  void sample_patch(const Eigen::Vector2d& place_px);
  /// Products of the gradients of template_ and patch_, summed up: their noise is independent, and not in the mean.
  Eigen::Matrix2d multiply_gradients_of_both();
  /// What white noise of variance 1, blurred by a path, makes.
  struct NoiseShare {
    Eigen::Matrix2d products = Eigen::Matrix2d::Zero();  // covariance of its products with the gradients
    double mean = 0;                                     // variance of the patch's mean
  };
  NoiseShare noise_share(const Path2d& path_px);

  PathPsf psf_of_first_, psf_of_second_;  // what first and second image are blurred by: the other's path
  Region first_, second_;
  PixelBox window_;                   // about the point, in the second image
  std::array<int, 2> spacing_{1, 1};  // of the columns and rows of the window that are compared; one of them 1
  Patch sorted_, sampled_, rows_, template_, gradient_x_, gradient_y_, patch_, difference_;
  std::vector<std::int32_t> pairs_;  // of pixels, for the kernels alone
  std::vector<int> offsets_;         // of a PSF's pairs
  std::vector<std::int32_t> weights_;
  std::vector<NoiseLag> lags_;
  struct GradientProducts {
    int away_x, away_y;
    Eigen::Matrix2d sums;
  };
  std::vector<GradientProducts> products_;  // of gradient_x_ and gradient_y_, as far as they have been asked for
  const AlignmentSimd& simd_ = select_for_cpu<AlignmentSimd>();
};

}  // namespace gyro_deblur
