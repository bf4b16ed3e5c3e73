// An engine that may fail, with one that does not behind it.
#pragma once

#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <vector>

#include "engine/engine.hpp"
#include "inverse/filter_bank.hpp"

namespace gyro_deblur {

/// A compute device that is absent, refuses its work or stopped working; what() is one line.
class DeviceError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Uses one engine until it throws DeviceError, and another from that very frame on. Other exceptions pass.
class FallbackEngine : public Engine {
 public:
  /// Preconditions: neither is null.
  FallbackEngine(std::unique_ptr<Engine> primary, std::unique_ptr<Engine> secondary);

  /// For a primary that failed before it existed.
  /// @param primary_name  what was asked for
  FallbackEngine(const std::string& primary_name, const DeviceError& error, std::unique_ptr<Engine> secondary);

  void filter(const cv::Mat& src, const FilterGrid& grid, cv::Mat& dst) override;

  /// Prepares both: the frame that the primary fails with does not wait either.
  void prepare(const std::vector<const LineKernel*>& kernels) override;

  /// The primary's name, or "SECONDARY (PRIMARY failed: reason)". Any thread may ask, also during filter().
  std::string name() const override;

  FallbackCounts fallback_counts() const override;

  std::string take_warning() override;

 private:
  void give_up(const std::string& primary_name, const DeviceError& error);

  mutable std::mutex mutex_;         // whoever changes or names the engine in use
  std::unique_ptr<Engine> primary_;  // null once it failed
  std::unique_ptr<Engine> secondary_;
  std::string failure_;  // empty while the primary works
  std::string warning_;  // not taken yet
};

}  // namespace gyro_deblur
