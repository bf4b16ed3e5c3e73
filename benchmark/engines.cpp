#include "engines.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <exception>
#include <string>

#include <opencv2/imgproc.hpp>

#include "engine/cpu/cpu_engine.hpp"
#include "inverse/line_taps.hpp"
#if defined(__x86_64__)
#include "engine/engine.hpp"
#include "float_copy.hpp"
#include "inverse/filter_bank.hpp"
#endif

namespace gyro_deblur::benchmark {
namespace {

/// Taps of a kernel along a line, with Lanczos' kernel of three lobes across.
std::vector<KernelTap> lanczos_taps(const LineKernel& kernel, double angle_rad) {
  constexpr int kLobes = 3;
  const auto [major_is_y, major, slope] = direction_of(angle_rad);
  std::vector<float> on_axis;
  kernel_on_major_axis(kernel, major, on_axis);
  const int steps = static_cast<int>(on_axis.size() / 2);
  const auto sinc = [](double x) { return x == 0 ? 1 : std::sin(CV_PI * x) / (CV_PI * x); };
  std::vector<KernelTap> taps;
  for (int m = -steps; m <= steps; ++m) {
    const double across = m * slope;
    const int first = static_cast<int>(std::floor(across)) - kLobes + 1;
    double weights[2 * kLobes], sum = 0;
    for (int i = 0; i < 2 * kLobes; ++i) {
      const double x = first + i - across;
      weights[i] = std::abs(x) < kLobes ? sinc(x) * sinc(x / kLobes) : 0;
      sum += weights[i];
    }
    for (int i = 0; i < 2 * kLobes; ++i) {
      const float weight = static_cast<float>(on_axis[m + steps] * weights[i] / sum);
      taps.push_back(major_is_y ? KernelTap{first + i, m, weight} : KernelTap{m, first + i, weight});
    }
  }
  return taps;
}

}  // namespace

std::string Filter2dEngine::name() const {
  return kind_ == Kind::BYTES ? "filter2d" : (kind_ == Kind::FLOATS ? "filter2d-float" : "filter2d-lanczos");
}

void Filter2dEngine::filter_blocks(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks,
                                   SeamBlender& seams, cv::Mat& dst) {
  CV_Assert(src.type() == CV_8UC1);
  const bool float_result = kind_ != Kind::BYTES;
  const int count = static_cast<int>(blocks.size());
  std::vector<cv::Mat> kernels(count);
  int pad = 0;
#pragma omp parallel for num_threads(threads()) schedule(dynamic) reduction(max : pad)
  for (int i = 0; i < count; ++i) {
    const BlockFilter& block = grid.blocks[blocks[i]];
    const std::vector<KernelTap> taps = kind_ == Kind::LANCZOS ? lanczos_taps(*block.kernel, block.angle_rad)
                                                               : rotate_kernel(*block.kernel, block.angle_rad);
    int reach_x = 0, reach_y = 0;
    for (const KernelTap& tap : taps) {
      reach_x = std::max(reach_x, std::abs(tap.dx));
      reach_y = std::max(reach_y, std::abs(tap.dy));
    }
    kernels[i] = cv::Mat::zeros(2 * reach_y + 1, 2 * reach_x + 1, CV_32F);
    // filter2D correlates.
    for (const KernelTap& tap : taps) kernels[i].at<float>(reach_y - tap.dy, reach_x - tap.dx) += tap.weight;
    pad = std::max({pad, reach_x, reach_y});
  }
  cv::Mat padded;
  cv::copyMakeBorder(src, padded, pad, pad, pad, pad, cv::BORDER_REPLICATE);
  cv::Mat result, block_result;
#pragma omp parallel for num_threads(float_result ? 1 : threads()) schedule(dynamic) firstprivate(result, block_result)
  for (int i = 0; i < count; ++i) {
    // A region of a larger image: the filter takes neighbours from outside the region.
    const cv::Rect rect = seams.reach(blocks[i]);
    const cv::Mat from = padded(rect + cv::Point(pad, pad));
    block_result.create(rect.size(), CV_8U);
    if (float_result) {
      cv::filter2D(from, result, CV_32F, kernels[i]);
      result.convertTo(block_result, CV_8U);
    } else {
      cv::filter2D(from, block_result, CV_8U, kernels[i]);
    }
    seams.store(blocks[i], block_result, dst);
  }
}

std::unique_ptr<Engine> make_engine(const std::string& name, int threads) {
  for (const auto kind : {Filter2dEngine::Kind::BYTES, Filter2dEngine::Kind::FLOATS, Filter2dEngine::Kind::LANCZOS}) {
    auto engine = std::make_unique<Filter2dEngine>(threads, kind);
    if (engine->name() == name) return engine;
  }
  const std::string prefix = "cpu-";
  if (name.compare(0, prefix.size(), prefix) == 0) {
    const BlockSimd* kernels = find_for_cpu<BlockSimd>(name.c_str() + prefix.size());
    if (kernels == nullptr) return nullptr;
    return std::make_unique<CpuEngine>(threads, *kernels);
  }
#if defined(__x86_64__)
  if (name == "float-avx2") return __builtin_cpu_supports("avx2") ? make_float_avx2(threads) : nullptr;
  if (name == "float-avx512") return __builtin_cpu_supports("avx512f") ? make_float_avx512(threads) : nullptr;
#endif
  try {
    return gyro_deblur::make_engine(name, threads);
  } catch (const std::exception&) {
    return nullptr;
  }
}

std::vector<std::string> available_engines() {
  std::vector<std::string> names;
  for (const char* name : {"cpu-avx512", "cpu-avx2", "cpu-dotprod", "cpu-baseline", "opencl", "float", "float-avx512",
                           "float-avx2", "filter2d", "filter2d-float"}) {
    const auto engine = make_engine(name, 1);
    // Without a device the cpu engine takes OpenCL's place.
    const bool is_replaced = std::string(name) == "opencl" && engine && engine->name().find("opencl") != 0;
    if (engine && !is_replaced) names.emplace_back(name);
  }
  return names;
}

}  // namespace gyro_deblur::benchmark
