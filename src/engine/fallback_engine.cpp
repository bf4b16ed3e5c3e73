// Replaces an engine that has failed.
#include "engine/fallback_engine.hpp"

#include <utility>

#include "inverse/filter_bank.hpp"

namespace gyro_deblur {

FallbackEngine::FallbackEngine(std::unique_ptr<Engine> primary, std::unique_ptr<Engine> secondary)
    : primary_(std::move(primary)), secondary_(std::move(secondary)) {}

FallbackEngine::FallbackEngine(const std::string& primary_name, const DeviceError& error,
                               std::unique_ptr<Engine> secondary)
    : secondary_(std::move(secondary)) {
  give_up(primary_name, error);
}

void FallbackEngine::give_up(const std::string& primary_name, const DeviceError& error) {
  const std::lock_guard<std::mutex> lock(mutex_);
  failure_ = primary_name + " failed: " + error.what();
  warning_ = failure_ + "; using " + secondary_->name() + " from now on";
  primary_.reset();
}

void FallbackEngine::filter(const cv::Mat& src, const FilterGrid& grid, cv::Mat& dst) {
  if (primary_) {
    try {
      primary_->filter(src, grid, dst);
      return;
    } catch (const DeviceError& error) {
      give_up(primary_->name(), error);
    }
  }
  secondary_->filter(src, grid, dst);
}

void FallbackEngine::prepare(const std::vector<const LineKernel*>& kernels) {
  if (primary_) primary_->prepare(kernels);
  secondary_->prepare(kernels);
}

std::string FallbackEngine::name() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return primary_ ? primary_->name() : secondary_->name() + " (" + failure_ + ")";
}

FallbackCounts FallbackEngine::fallback_counts() const {
  return primary_ ? primary_->fallback_counts() : secondary_->fallback_counts();
}

std::string FallbackEngine::take_warning() {
  const std::lock_guard<std::mutex> lock(mutex_);
  std::string warning = std::exchange(warning_, {});
  // The engine in use may have something to say as well.
  Engine& engine = primary_ ? *primary_ : *secondary_;
  return warning.empty() ? engine.take_warning() : warning;
}

}  // namespace gyro_deblur
