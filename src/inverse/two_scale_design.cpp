// Designs the weights of two scales by least squares.
#include "inverse/two_scale_design.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <opencv2/core.hpp>

namespace gyro_deblur {
namespace {

// What the fit is made for: lines of a blurred photograph with noise. Neighbouring pixels of natural images correlate
// by 0.95 (A. K. Jain, Fundamentals of Digital Image Processing, 1989, section 2.10, gives 0.95 as typical), and vary
// by about 50 grey levels; noise and rounding to 8 bits are about 1 grey level. Without this weight the sums that the
// two scales have to get right, those of slow changes, are 10 dB worse.
constexpr double kNeighbourCorrelation = 0.95;
constexpr double kImageVariance = 50.0 * 50.0;
constexpr double kNoiseVariance = 1.0 + 1.0 / 12;

// Nodes of the smooth part in a box: more restore hardly more (doc/reports/filter_constants.md).
constexpr int kNodesPerBox = 15;
constexpr int kMinDecimation = 2;

/// Sines and cosines of the frequencies f / period [cycles/sample], f = 0 .. period / 2, from one table.
class Waves {
 public:
  explicit Waves(int period) : period_(period), quarter_(period / 2 + 1) {
    for (int i = 0; i <= period / 2; ++i) quarter_[i] = std::sin(M_PI * i / period);
  }

  int period() const { return period_; }
  /// cos(2 pi f k / period).
  double cosine(int f, int k) const { return half_wave(2 * f * k + period_ / 2); }
  /// Sum of cos(2 pi f x / period) over `count` places x, one apart and symmetric about 0.
  double box(int f, int count) const { return f == 0 ? count : half_wave(f * count) / half_wave(f); }

 private:
  /// sin(pi i / period).
  double half_wave(int i) const {
    i %= 2 * period_;
    const double sign = i < period_ ? 1 : -1;
    if (i >= period_) i -= period_;
    return sign * quarter_[std::min(i, period_ - i)];
  }

  int period_;  // even
  std::vector<double> quarter_;
};

/// An even sequence from its spectrum, both given by one half.
class EvenSequence {
 public:
  explicit EvenSequence(std::vector<double> spectrum) {
    const int period = 2 * (static_cast<int>(spectrum.size()) - 1);
    for (int f = period / 2 + 1; f < period; ++f) spectrum.push_back(spectrum[period - f]);
    // Packed: of element 0 the real part, of the others real and imaginary parts in turn, which are 0.
    cv::Mat packed;
    cv::dft(cv::Mat(1, period, CV_64F, spectrum.data()), packed);
    for (int x = 0; x <= period / 2; ++x) values_.push_back(packed.at<double>(x == 0 ? 0 : 2 * x - 1));
  }
  /// Value at x, |x| <= half the period.
  double operator()(int x) const { return values_[std::abs(x)]; }

 private:
  std::vector<double> values_;
};

/// What the nodes of a decimation by d make of a frequency, as means over the d places that an output may have in its
/// node.
class NodeResponse {
 public:
  explicit NodeResponse(int d) : d_(d) {
    for (int phase = 0; phase < d; ++phase) {
      const double u = (phase - (d - 1) / 2.0) / d;  // the output's place in its node
      const double spline[] = {(0.5 - u) * (0.5 - u) / 2, 0.75 - u * u, (0.5 + u) * (0.5 + u) / 2};
      lags_[0] += (spline[0] * spline[0] + spline[1] * spline[1] + spline[2] * spline[2]) / d;
      lags_[1] += 2 * spline[1] * (spline[0] + spline[2]) / d;
      lags_[2] += 2 * spline[0] * spline[2] / d;
    }
  }

  /// The spline at all of these places is three times the sum of d samples, and the spline with a decimation by 1:
  /// 1 / 8, 3 / 4, 1 / 8.
  double mean(const Waves& waves, int f) const {
    const double node = waves.box(f, d_), square = node * node;
    return square * square / (static_cast<double>(d_) * d_ * d_) * (0.75 + 0.25 * waves.cosine(f, 1));
  }
  double power(const Waves& waves, int f) const {
    const double node = waves.box(f, d_);
    return node * node * (lags_[0] + lags_[1] * waves.cosine(f, d_) + lags_[2] * waves.cosine(f, 2 * d_));
  }

 private:
  int d_;
  double lags_[3] = {};  // of the spline's weights with each other, both ways
};

/// Spectra of the correlations of node shapes with each other, with a tap and with boxes, and of boxes with taps; and
/// the correlations of boxes at one place.
struct Correlations {
  std::vector<double> node_node, node_tap, node_box[2], box_tap[2];
  double box_box[2][2] = {};

  Correlations(int box_half, int d, const Waves& waves) {
    const NodeResponse response(d);
    const int last = waves.period() / 2;
    for (int f = 0; f <= last; ++f) {
      const double boxes[] = {waves.box(f, 2 * box_half + 1), waves.box(f, 2 * box_half + 3)};
      const double blur = boxes[0] / (2 * box_half + 1);
      const double image = (1 - kNeighbourCorrelation * kNeighbourCorrelation) /
                           (1 + kNeighbourCorrelation * (kNeighbourCorrelation - 2 * waves.cosine(f, 1)));
      const double covariance = kImageVariance * image * blur * blur + kNoiseVariance;

      const double mean = response.mean(waves, f);
      node_node.push_back(covariance * response.power(waves, f));
      node_tap.push_back(covariance * mean);
      for (int b = 0; b < 2; ++b) {
        node_box[b].push_back(covariance * mean * boxes[b]);
        box_tap[b].push_back(covariance * boxes[b]);
        for (int c = 0; c < 2; ++c) {
          box_box[b][c] += (f == 0 || f == last ? 1 : 2) * covariance * boxes[b] * boxes[c];
        }
      }
    }
  }
};

/// Room for the difference of any two places, so that nothing wraps around, in a transform that is fast. A power of two
/// where it is short: the correlations fade as 0.95 to the lag.
int period_for(int reach, int d) {
  constexpr int kLong = 2048;
  const int least = 4 * (reach + 3 * d);
  if (least > kLong) return 2 * cv::getOptimalDFTSize((least + 1) / 2);
  int period = 1;
  while (period < least) period *= 2;
  return period;
}

/// In four parts, which need not wait for each other.
double sum_of(const float* values, int count) {
  double sums[4] = {};
  int i = 0;
  for (; i + 4 <= count; i += 4) {
    for (int k = 0; k < 4; ++k) sums[k] += values[i + k];
  }
  for (; i < count; ++i) sums[0] += values[i];
  return (sums[0] + sums[1]) + (sums[2] + sums[3]);
}

/// normal * map = taps, and sums' map = the taps' own sums. Unknowns are the weights of nodes 0 .. radius, of the inner
/// and of the outer box; a column of `taps` for each tap 0 .. reach.
struct NormalEquations {
  Eigen::MatrixXd normal, taps;
  Eigen::VectorXd sums;

  NormalEquations(int box_half, int d, int radius) {
    const int reach = radius * d, coarse = radius + 1, unknowns = coarse + 2;
    const Correlations of(box_half, d, Waves(period_for(reach, d)));
    normal.resize(unknowns, unknowns);
    taps.resize(unknowns, reach + 1);
    sums.resize(unknowns);
    // Weight j stands for nodes j and -j, and tap m for m and -m.
    const auto both_sides = [](const EvenSequence& sequence, int a, int b) {
      return (sequence(a - b) + sequence(a + b)) * (a == 0 ? 1 : 2) * (b == 0 ? 1 : 2) / 2;
    };
    const EvenSequence of_nodes(of.node_node), of_node_and_tap(of.node_tap);
    for (int j = 0; j < coarse; ++j) {
      for (int i = 0; i <= j; ++i) normal(i, j) = normal(j, i) = both_sides(of_nodes, i * d, j * d);
      for (int m = 0; m <= reach; ++m) taps(j, m) = both_sides(of_node_and_tap, j * d, m);
      sums[j] = (j == 0 ? 1 : 2) * d;
    }
    for (int b = 0; b < 2; ++b) {
      const EvenSequence of_box_and_node(of.node_box[b]), of_box_and_tap(of.box_tap[b]);
      for (int j = 0; j < coarse; ++j) {
        normal(j, coarse + b) = normal(coarse + b, j) = both_sides(of_box_and_node, j * d, 0);
      }
      for (int m = 0; m <= reach; ++m) taps(coarse + b, m) = both_sides(of_box_and_tap, m, 0);
      for (int c = 0; c < 2; ++c) normal(coarse + b, coarse + c) = of.box_box[b][c];
      sums[coarse + b] = 2 * (box_half + b) + 1;
    }
  }
};

}  // namespace

int TwoScaleDesign::decimation_for(int box_half) {
  return std::max(kMinDecimation, static_cast<int>(std::lround(2.0 * (box_half + 1) / kNodesPerBox)));
}

// Minimises the mean over the d phases of an output within its node of (A_p w - k)' C (A_p w - k), where A_p makes a
// kernel of weights and C is the covariance of the samples, subject to the kernel's sum. C is diagonal in the frequency
// domain, and the unknowns are shifted copies of a few shapes, so that all products of them are samples of a few
// correlations.
TwoScaleDesign::TwoScaleDesign(int box_half, int radius)
    : box_half_(box_half), decimation_(decimation_for(box_half)), radius_(radius) {
  const NormalEquations equations(box_half, decimation_, radius);
  const Eigen::VectorXd& sums = equations.sums;
  const Eigen::LDLT<Eigen::MatrixXd> solver(equations.normal);
  Eigen::MatrixXd map = solver.solve(equations.taps);
  // The sum, by a Lagrange multiplier.
  const Eigen::VectorXd direction = solver.solve(sums);
  Eigen::RowVectorXd missing = -(sums.transpose() * map);
  const int reach = this->reach(), unknowns = static_cast<int>(sums.size());
  for (int m = 0; m <= reach; ++m) missing[m] += m == 0 ? 1 : 2;
  map += direction * missing / sums.dot(direction);

  row_groups_ = (unknowns + kRowGroup - 1) / kRowGroup;
  map_.assign(static_cast<std::size_t>(row_groups_) * (reach + 1) * kRowGroup, 0.0f);
  for (int m = 0; m <= reach; ++m) {
    for (int i = 0; i < unknowns; ++i) {
      map_[(static_cast<std::size_t>(i / kRowGroup) * (reach + 1) + m) * kRowGroup + i % kRowGroup] =
          static_cast<float>(map(i, m));
    }
  }
}

void TwoScaleDesign::fit(const float* kernel, int count, const TapSimd& simd, TwoScaleWeights& weights) const {
  weights.coarse.resize(row_groups_ * kRowGroup);
  float* sums = weights.coarse.data();
  for (int group = 0; group < row_groups_; ++group) {
    simd.combine_columns(map_.data() + static_cast<std::size_t>(group) * (reach() + 1) * kRowGroup, kernel, count + 1,
                         sums + group * kRowGroup);
  }
  double missing = 2 * sum_of(kernel, count + 1) - kernel[0];
  weights.inner_box = sums[radius_ + 1];
  weights.outer_box = sums[radius_ + 2];
  weights.coarse.resize(radius_ + 1);
  // What rounding has left of the sum: box and coarse part nearly cancel in it.
  missing -= static_cast<double>(weights.inner_box) * (2 * box_half_ + 1) +
             static_cast<double>(weights.outer_box) * (2 * box_half_ + 3);
  for (int j = 0; j <= radius_; ++j) missing -= (j == 0 ? 1.0 : 2.0) * decimation_ * weights.coarse[j];
  const float share = static_cast<float>(missing / (decimation_ * (2 * radius_ + 1)));
  for (float& weight : weights.coarse) weight += share;
}

}  // namespace gyro_deblur
