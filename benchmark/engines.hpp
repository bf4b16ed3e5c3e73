// Engines under measurement, by name.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "engine/block_engine.hpp"
#include "engine/engine.hpp"
#include "pipeline/deconvolution.hpp"

namespace gyro_deblur::benchmark {

/// cv::filter2D with each block's rotated kernel as a matrix (its bounding box). CV_8UC1 only.
class Filter2dEngine : public BlockEngine {
 public:
  enum class Kind {
    BYTES,    ///< 8-bit result, OpenMP over blocks: the most that can be had from it
    FLOATS,   ///< as it is called when values outside [0, 255] matter: CV_32F result, one block after another, with
              ///< whatever threads OpenCV uses itself
    LANCZOS,  ///< FLOATS, but between neighbours across the line the image is interpolated by six taps of Lanczos'
              ///< kernel instead of two of the linear one: what nearly ideal sampling gives
  };
  Filter2dEngine(int threads, Kind kind) : BlockEngine(threads), kind_(kind) {}
  std::string name() const override;

 protected:
  void filter_blocks(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks, SeamBlender& seams,
                     cv::Mat& dst) override;

 private:
  Kind kind_;
};

/// Engine by name, on `threads` OpenMP threads:
///   float                     as released (instruction set chosen by the loader)
///   float-avx2, float-avx512  its source compiled for that instruction set alone
///   cpu-baseline, cpu-avx2, cpu-avx512
///   filter2d, filter2d-float, filter2d-lanczos
///   anything else                     make_engine
/// Null where this build or processor does not have it.
std::unique_ptr<Engine> make_engine(const std::string& name, int threads);

/// Names of all engines whose speed matters and that can run here, slowest last.
std::vector<std::string> available_engines();

}  // namespace gyro_deblur::benchmark
