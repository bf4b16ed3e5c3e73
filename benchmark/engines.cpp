#include "engines.hpp"

#include <omp.h>

#include <algorithm>
#include <cstdlib>
#include <exception>
#include <string>

#include <opencv2/imgproc.hpp>

#include "cpu/cpu_convolver.hpp"
#if defined(__x86_64__)
#include "reference_copy.hpp"
#endif

namespace gyro_deblur::benchmark {

void Filter2dConvolver::convolve(const cv::Mat& src, const FilterGrid& grid, cv::Mat& dst) {
  CV_Assert(src.type() == CV_8UC1);
  dst.create(src.size(), src.type());
  const int threads = threads_ > 0 ? threads_ : omp_get_max_threads();
  const std::vector<BlockFilter>& blocks = grid.blocks;
  const int count = static_cast<int>(blocks.size());
  seams_.plan(grid, src.type());
  std::vector<cv::Mat> kernels(count);
  int pad = 0;
#pragma omp parallel for num_threads(threads) schedule(dynamic) reduction(max : pad)
  for (int i = 0; i < count; ++i) {
    if (blocks[i].kernel == nullptr) continue;
    const std::vector<KernelTap> taps = rotate_kernel(*blocks[i].kernel, blocks[i].angle_rad);
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
#pragma omp parallel for num_threads(float_result_ ? 1 : threads) schedule(dynamic) firstprivate(result, block_result)
  for (int i = 0; i < count; ++i) {
    if (kernels[i].empty()) {
      src(grid.rect(i)).copyTo(dst(grid.rect(i)));
      continue;
    }
    // A region of a larger image: the filter takes neighbours from outside the region.
    const cv::Rect rect = seams_.reach(i);
    const cv::Mat from = padded(rect + cv::Point(pad, pad));
    block_result.create(rect.size(), CV_8U);
    if (float_result_) {
      cv::filter2D(from, result, CV_32F, kernels[i]);
      result.convertTo(block_result, CV_8U);
    } else {
      cv::filter2D(from, block_result, CV_8U, kernels[i]);
    }
    seams_.store(i, block_result.data, dst);
  }
  seams_.blend(src, float_result_ ? 1 : threads, dst);
}

std::unique_ptr<LineConvolver> make_engine(const std::string& name, int threads) {
  if (name == "filter2d" || name == "filter2d-float") {
    return std::make_unique<Filter2dConvolver>(threads, name == "filter2d-float");
  }
  const std::string prefix = "cpu-";
  if (name.compare(0, prefix.size(), prefix) == 0) {
    const BlockKernels* kernels = find_block_kernels(name.c_str() + prefix.size());
    if (kernels == nullptr) return nullptr;
    return std::make_unique<CpuConvolver>(threads, *kernels);
  }
#if defined(__x86_64__)
  if (name == "reference-avx2") return __builtin_cpu_supports("avx2") ? make_reference_avx2(threads) : nullptr;
  if (name == "reference-avx512") return __builtin_cpu_supports("avx512f") ? make_reference_avx512(threads) : nullptr;
#endif
  try {
    return make_line_convolver(name, threads);
  } catch (const std::exception&) {
    return nullptr;
  }
}

std::vector<std::string> available_engines() {
  std::vector<std::string> names;
  for (const char* name : {"cpu-avx512", "cpu-avx2", "cpu-baseline", "opencl", "reference", "reference-avx512",
                           "reference-avx2", "filter2d", "filter2d-float"}) {
    const auto engine = make_engine(name, 1);
    // Without a device the cpu engine takes OpenCL's place.
    const bool is_replaced = std::string(name) == "opencl" && engine && engine->name().find("opencl") != 0;
    if (engine && !is_replaced) names.emplace_back(name);
  }
  return names;
}

}  // namespace gyro_deblur::benchmark
