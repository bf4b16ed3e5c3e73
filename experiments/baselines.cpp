#include "baselines.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

#include <opencv2/imgproc.hpp>

#include "base/require_range.hpp"
#include "blur/image_noise.hpp"
#include "engine/engine.hpp"
#include "evaluation.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "inverse/filter_bank.hpp"
#include "inverse/line_taps.hpp"
#include "pipeline/deconvolution.hpp"

namespace gyro_deblur::experiments {
namespace {

void require_gray8(const cv::Mat& image) {
  if (image.type() != CV_8UC1 || image.empty()) throw std::invalid_argument("the experiments take CV_8UC1 images");
}

/// Frequency [cycles / px] of element i of n of a spectrum.
double frequency_of(int i, int n) { return static_cast<double>(i <= n / 2 ? i : i - n) / n; }

/// Multiplies a complex spectrum (CV_32FC2 or CV_64FC2) by gain(fx, fy).
template <typename Complex, typename Gain>
void multiply(cv::Mat& spectrum, const Gain& gain) {
  for (int v = 0; v < spectrum.rows; ++v) {
    const double fy = frequency_of(v, spectrum.rows);
    Complex* row = spectrum.ptr<Complex>(v);
    for (int u = 0; u < spectrum.cols; ++u) {
      row[u] *= static_cast<typename Complex::value_type>(gain(frequency_of(u, spectrum.cols), fy));
    }
  }
}

/// Spectrum of a line at one frequency: sinc(extent * frequency along the line).
double line_spectrum(const LineBlur& blur, double fx, double fy) {
  const double x = CV_PI * blur.extent_px * (fx * std::cos(blur.angle_rad) + fy * std::sin(blur.angle_rad));
  return std::abs(x) < 1e-9 ? 1.0 : std::sin(x) / x;
}

/// `image` filtered by gain(fx, fy), as one period of a periodic plane. CV_64F.
template <typename Gain>
cv::Mat filter_periodic(const cv::Mat& image, const Gain& gain) {
  cv::Mat real, spectrum, filtered;
  image.convertTo(real, CV_64F);
  cv::dft(real, spectrum, cv::DFT_COMPLEX_OUTPUT);
  multiply<cv::Vec2d>(spectrum, gain);
  cv::dft(spectrum, filtered, cv::DFT_INVERSE | cv::DFT_SCALE | cv::DFT_REAL_OUTPUT);
  return filtered;
}

}  // namespace

FrameBlur as_blurred(FrameBlur field) {
  for (BlockBlur& block : field.blocks) {
    if (block.status == BlockStatus::DEBLURRED) block.status = BlockStatus::SHARP;
  }
  return field;
}

cv::Mat deblur_in_space(const cv::Mat& image, const LineBlur& blur, const FilterOptions& options) {
  require_gray8(image);
  require_range("extent", blur.extent_px, kMinKernelExtentPx, kMaxKernelExtentPx, "px");
  // The blur is given, so nothing is exempt from deblurring.
  BlurFieldOptions field_options;
  field_options.min_extent_px = kMinKernelExtentPx;
  field_options.max_extent_px = kMaxKernelExtentPx;
  FrameBlur field = uniform_blur_field(image.cols, image.rows, blur.angle_rad, blur.extent_px, field_options);
  const FilterBank bank(options);
  field.noise = image_noise(image, PixelLayout::GRAY);
  adapt_regularization(image, bank, field, 1);
  cv::Mat deblurred;
  deconvolve(image, PixelLayout::GRAY, field, bank, *make_engine("cpu", 1), deblurred);
  return deblurred;
}

cv::Mat taper_edges(const cv::Mat& image, const LineBlur& blur) {
  const cv::Mat blurred = filter_periodic(image, [&](double fx, double fy) { return line_spectrum(blur, fx, fy); });
  // The projection of a line is a box, whose autocorrelation is a triangle.
  const auto weights = [](int n, double projected_px) {
    std::vector<double> weight(n);
    for (int i = 0; i < n; ++i) weight[i] = std::min(1.0, std::min(i, n - 1 - i) / std::max(projected_px, 1.0));
    return weight;
  };
  const auto weight_x = weights(image.cols, blur.extent_px * std::abs(std::cos(blur.angle_rad)));
  const auto weight_y = weights(image.rows, blur.extent_px * std::abs(std::sin(blur.angle_rad)));
  cv::Mat tapered;
  image.convertTo(tapered, CV_64F);
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      const double weight = weight_x[x] * weight_y[y];
      double& value = tapered.at<double>(y, x);
      value = weight * value + (1 - weight) * blurred.at<double>(y, x);
    }
  }
  return tapered;
}

cv::Mat deblur_in_frequency(const cv::Mat& image, const LineBlur& blur, double noise_to_signal_ratio, bool taper) {
  require_range("noise_to_signal_ratio", noise_to_signal_ratio, 1e-5, 1);
  return filter_periodic(taper ? taper_edges(image, blur) : image, [&](double fx, double fy) {
    const double H = line_spectrum(blur, fx, fy);
    return (1 + noise_to_signal_ratio) * H / (H * H + noise_to_signal_ratio);
  });
}

void RestorationOptions::validate() const {
  require_range("noise_to_signal_ratio", noise_to_signal_ratio, 1e-5, 1);
  require_range("length_factor", length_factor, 2, 8);
  require_range("iterations", iterations, 0, 100);
  require_range("padding", padding, 0.5, 10);
  require_range("prior_sigma", prior_sigma_px, 0, 20, "px");
  require_range("output_sigma", output_sigma_px, 0, 20, "px");
}

cv::Mat restore_beyond_borders(const cv::Mat& image, const LineBlur& blur, const RestorationOptions& options) {
  require_gray8(image);
  options.validate();
  // Shorter blurs leave less noise to smooth.
  constexpr double kShortExtentPx = 20;
  const double output_sigma_px = blur.extent_px < kShortExtentPx ? options.prior_sigma_px : options.output_sigma_px;

  const int pad = static_cast<int>(std::ceil(options.padding * blur.extent_px));
  const cv::Size size(cv::getOptimalDFTSize(image.cols + 2 * pad), cv::getOptimalDFTSize(image.rows + 2 * pad));
  const cv::Rect seen(pad, pad, image.cols, image.rows);
  cv::Mat y;
  image.convertTo(y, CV_32F);
  cv::copyMakeBorder(y, y, pad, size.height - image.rows - pad, pad, size.width - image.cols - pad,
                     cv::BORDER_REPLICATE);

  const auto spectrum_of = [](const cv::Mat& plane) {
    cv::Mat spectrum;
    cv::dft(plane, spectrum, cv::DFT_COMPLEX_OUTPUT);
    return spectrum;
  };
  const auto plane_of = [](const cv::Mat& spectrum) {
    cv::Mat plane;
    cv::dft(spectrum, plane, cv::DFT_INVERSE | cv::DFT_SCALE | cv::DFT_REAL_OUTPUT);
    return plane;
  };
  // Filters as spectra. W is the paper's kernel, a spatial one of limited length; its centre goes to the origin.
  cv::Mat inverse = cv::Mat::zeros(size, CV_32F);
  FilterOptions kernel_options;
  kernel_options.noise_to_signal_ratio = options.noise_to_signal_ratio;
  kernel_options.length_factor = options.length_factor;
  kernel_options.regularization = Regularization::PAPER;
  const LineKernel kernel = wiener_kernel(blur.extent_px, kernel_options);
  for (const KernelTap& tap : rotate_kernel(kernel, blur.angle_rad)) {
    const int u = ((tap.dx % size.width) + size.width) % size.width;
    const int v = ((tap.dy % size.height) + size.height) % size.height;
    inverse.at<float>(v, u) += tap.weight;
  }
  const cv::Mat W = spectrum_of(inverse);
  const auto gaussian = [&](const cv::Mat& spectrum, double sigma_px) {
    cv::Mat smooth = spectrum.clone();
    multiply<cv::Vec2f>(smooth, [&](double fx, double fy) {
      return std::exp(-2 * CV_PI * CV_PI * sigma_px * sigma_px * (fx * fx + fy * fy));
    });
    return smooth;
  };

  cv::Mat X;
  cv::mulSpectrums(W, spectrum_of(y), X, 0);
  for (int i = 0; i < options.iterations; ++i) {
    const cv::Mat Z = gaussian(X, options.prior_sigma_px);
    cv::Mat predicted = Z.clone();
    multiply<cv::Vec2f>(predicted, [&](double fx, double fy) { return line_spectrum(blur, fx, fy); });
    cv::Mat residual = cv::Mat::zeros(size, CV_32F);
    cv::subtract(y(seen), plane_of(predicted)(seen), residual(seen));
    cv::Mat correction;
    cv::mulSpectrums(W, spectrum_of(residual), correction, 0);
    X = Z + correction;
  }
  cv::Mat restored;
  plane_of(gaussian(X, output_sigma_px))(seen).convertTo(restored, CV_8U);
  return restored;
}

namespace {

// Lowe 2004, as cv::SIFT with a contrast threshold of 0: the adapted scale space is the only difference.
constexpr int kLayers = 3;              // per octave
constexpr double kBaseSigmaPx = 0.8;    // of the first layer of the first octave, whose step is half a pixel
constexpr double kCameraSigmaPx = 0.5;  // that the image is taken to have already
constexpr double kMaxCurvatureRatio = 10;
constexpr int kBorder = 5;    // samples of an octave
constexpr int kMaxSteps = 5;  // of the sub-pixel refinement
// What the planes are at least continued by before they are taken as periodic.
constexpr int kMinPadPx = 128;

/// The frequencies that `size` samples can hold of a spectrum of another size; scaled so that values stay what they
/// are.
cv::Mat resample_spectrum(const cv::Mat& spectrum, const cv::Size& size) {
  cv::Mat resampled = cv::Mat::zeros(size, CV_32FC2);
  const int cols = std::min(size.width, spectrum.cols), rows = std::min(size.height, spectrum.rows);
  const float scale = static_cast<float>(size.area()) / spectrum.total();
  // Without the Nyquist frequency, which has no partner.
  for (int v = -(rows / 2) + 1; v < rows / 2; ++v) {
    const cv::Vec2f* from = spectrum.ptr<cv::Vec2f>(v < 0 ? v + spectrum.rows : v);
    cv::Vec2f* to = resampled.ptr<cv::Vec2f>(v < 0 ? v + size.height : v);
    for (int u = -(cols / 2) + 1; u < cols / 2; ++u) {
      to[u < 0 ? u + size.width : u] = from[u < 0 ? u + spectrum.cols : u] * scale;
    }
  }
  return resampled;
}

/// Differences of neighbouring layers of one octave.
using Octave = std::array<cv::Mat, kLayers + 2>;

/// Whether the sample is larger than its 26 neighbours when positive, smaller when negative.
bool is_extremum(const Octave& dog, int layer, int y, int x) {
  const float value = dog[layer].at<float>(y, x);
  if (value == 0) return false;
  const float sign = value > 0 ? 1.0f : -1.0f;
  for (int l = layer - 1; l <= layer + 1; ++l) {
    for (int v = y - 1; v <= y + 1; ++v) {
      const float* row = dog[l].ptr<float>(v);
      for (int u = x - 1; u <= x + 1; ++u) {
        if (sign * row[u] > sign * value) return false;
      }
    }
  }
  return true;
}

/// Refines an extremum by a parabola through its neighbours (Brown and Lowe, BMVC 2002) and drops edges.
bool refine(const Octave& dog, int layer, int y, int x, double step_px, double octave_sigma_px,
            cv::KeyPoint& keypoint) {
  cv::Vec3f offset, gradient;
  cv::Matx33f hessian;
  for (int i = 0;; ++i) {
    if (i == kMaxSteps) return false;
    const auto at = [&](int dx, int dy, int dl) { return dog[layer + dl].at<float>(y + dy, x + dx); };
    const float center = at(0, 0, 0);
    gradient = cv::Vec3f(at(1, 0, 0) - at(-1, 0, 0), at(0, 1, 0) - at(0, -1, 0), at(0, 0, 1) - at(0, 0, -1)) / 2;
    const float xx = at(1, 0, 0) + at(-1, 0, 0) - 2 * center, yy = at(0, 1, 0) + at(0, -1, 0) - 2 * center,
                ll = at(0, 0, 1) + at(0, 0, -1) - 2 * center;
    const float xy = (at(1, 1, 0) - at(-1, 1, 0) - at(1, -1, 0) + at(-1, -1, 0)) / 4,
                xl = (at(1, 0, 1) - at(-1, 0, 1) - at(1, 0, -1) + at(-1, 0, -1)) / 4,
                yl = (at(0, 1, 1) - at(0, -1, 1) - at(0, 1, -1) + at(0, -1, -1)) / 4;
    hessian = cv::Matx33f(xx, xy, xl, xy, yy, yl, xl, yl, ll);
    offset = -hessian.solve(gradient, cv::DECOMP_LU);
    if (!(std::abs(offset[0]) < 1e3f && std::abs(offset[1]) < 1e3f && std::abs(offset[2]) < 1e3f)) return false;
    if (std::abs(offset[0]) < 0.5f && std::abs(offset[1]) < 0.5f && std::abs(offset[2]) < 0.5f) break;
    x += cvRound(offset[0]);
    y += cvRound(offset[1]);
    layer += cvRound(offset[2]);
    if (layer < 1 || layer > kLayers || x < kBorder || x >= dog[0].cols - kBorder || y < kBorder ||
        y >= dog[0].rows - kBorder) {
      return false;
    }
  }
  const float trace = hessian(0, 0) + hessian(1, 1);
  const float determinant = hessian(0, 0) * hessian(1, 1) - hessian(0, 1) * hessian(0, 1);
  constexpr double kRatio = kMaxCurvatureRatio;
  if (determinant <= 0 || trace * trace * kRatio >= (kRatio + 1) * (kRatio + 1) * determinant) return false;

  keypoint.pt =
      cv::Point2f(static_cast<float>((x + offset[0]) * step_px), static_cast<float>((y + offset[1]) * step_px));
  keypoint.size = static_cast<float>(2 * octave_sigma_px * std::exp2((layer + offset[2]) / kLayers));
  keypoint.response = std::abs(dog[layer].at<float>(y, x) + 0.5f * gradient.dot(offset)) / 255;
  return true;
}

}  // namespace

// What the paper says of Pretto et al. is to build the Gaussian pyramid with less blur along the motion instead of an
// isotropic one. Taken here as follows. The variance of a uniform motion over r pixels along its line is r^2 / 12. A
// layer that stands for the scale sigma has the variance sigma^2 across the line, and along it what the motion has left
// to add: motion and smoothing together are isotropic from sigma = r / sqrt(12) on; below, nothing is added along the
// line. Extrema, sub-pixel refinement, the test for edges and the response are SIFT's. Pretto et al. also discard
// keypoints whose descriptors have a low entropy; like the paper's, this one does not.
std::vector<cv::KeyPoint> detect_motion_adapted_dog(const cv::Mat& image, const LineBlur& blur) {
  require_gray8(image);
  require_range("extent", blur.extent_px, 0, kMaxKernelExtentPx, "px");
  // Until the smaller side has about 8 samples left, as in OpenCV's SIFT.
  const int octaves = cvRound(std::log2(std::min(image.cols, image.rows)) - 2) + 1;
  const int multiple = 1 << octaves;
  const int pad_px = std::max(kMinPadPx, multiple / 4);  // whole samples of the last octave
  const auto padded = [&](int n) { return (n + 2 * pad_px + multiple - 1) / multiple * multiple; };
  const cv::Size size(padded(image.cols), padded(image.rows));
  cv::Mat real, spectrum;
  image.convertTo(real, CV_32F);
  cv::copyMakeBorder(real, real, pad_px, size.height - image.rows - pad_px, pad_px, size.width - image.cols - pad_px,
                     cv::BORDER_REFLECT_101);
  cv::dft(real, spectrum, cv::DFT_COMPLEX_OUTPUT);

  const double dx = std::cos(blur.angle_rad), dy = std::sin(blur.angle_rad);
  const double camera_variance = kCameraSigmaPx * kCameraSigmaPx;
  const double motion_variance = blur.extent_px * blur.extent_px / 12;
  std::vector<cv::KeyPoint> keypoints;
  for (int o = 0; o < octaves; ++o) {
    const double step_px = 0.5 * (1 << o), octave_sigma_px = kBaseSigmaPx * (1 << o);
    const cv::Size octave_size(cvRound(size.width / step_px), cvRound(size.height / step_px));
    const cv::Rect inside(cvRound(pad_px / step_px), cvRound(pad_px / step_px),
                          static_cast<int>((image.cols - 1) / step_px) + 1,
                          static_cast<int>((image.rows - 1) / step_px) + 1);
    const cv::Mat octave_spectrum = resample_spectrum(spectrum, octave_size);
    Octave dog;
    cv::Mat former;
    for (int i = 0; i < kLayers + 3; ++i) {
      const double sigma_px = octave_sigma_px * std::exp2(static_cast<double>(i) / kLayers);
      const double across = sigma_px * sigma_px - camera_variance;
      const double along = std::max(across - motion_variance, 0.0);
      cv::Mat layer_spectrum = octave_spectrum.clone(), layer;
      multiply<cv::Vec2f>(layer_spectrum, [&](double fx, double fy) {
        const double f_along = (fx * dx + fy * dy) / step_px, f_across = (fy * dx - fx * dy) / step_px;
        return std::exp(-2 * CV_PI * CV_PI * (along * f_along * f_along + across * f_across * f_across));
      });
      cv::dft(layer_spectrum, layer, cv::DFT_INVERSE | cv::DFT_SCALE | cv::DFT_REAL_OUTPUT);
      layer = layer(inside).clone();
      if (i > 0) cv::subtract(layer, former, dog[i - 1]);
      former = layer;
    }
    for (int layer = 1; layer <= kLayers; ++layer) {
      for (int y = kBorder; y < inside.height - kBorder; ++y) {
        for (int x = kBorder; x < inside.width - kBorder; ++x) {
          cv::KeyPoint keypoint;
          if (!is_extremum(dog, layer, y, x)) continue;
          if (refine(dog, layer, y, x, step_px, octave_sigma_px, keypoint)) keypoints.push_back(keypoint);
        }
      }
    }
  }
  std::stable_sort(keypoints.begin(), keypoints.end(),
                   [](const cv::KeyPoint& a, const cv::KeyPoint& b) { return a.response > b.response; });
  return without_duplicates(keypoints);
}

}  // namespace gyro_deblur::experiments
