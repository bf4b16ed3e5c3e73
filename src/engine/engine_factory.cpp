// Makes the engine that an option names.
#include <memory>
#include <string>
#include <utility>

#include "base/require_range.hpp"
#include "engine/cpu/cpu_engine.hpp"
#include "engine/engine.hpp"
#include "engine/fallback_engine.hpp"
#include "engine/float/float_engine.hpp"
#include "engine/opencl/opencl_factory.hpp"
#include "gyro_deblur/options.hpp"

namespace gyro_deblur {
namespace {

/// The OpenCL engine with the CPU engine behind it.
std::unique_ptr<Engine> make_opencl_with_fallback(const std::string& device, int threads) {
  auto cpu = std::make_unique<CpuEngine>(threads);
  try {
    return std::make_unique<FallbackEngine>(make_opencl_engine(device, threads), std::move(cpu));
  } catch (const DeviceError& error) {
    return std::make_unique<FallbackEngine>("OpenCL", error, std::move(cpu));
  }
}

std::unique_ptr<Engine> make_cpu(const std::string&, int threads) { return std::make_unique<CpuEngine>(threads); }

/// The 2-D filter for all blocks, but for those that come with a 1-D kernel all the same.
class FourierEngine : public CpuEngine {
 public:
  using CpuEngine::CpuEngine;
  std::string name() const override { return "fourier, " + CpuEngine::name(); }
  bool prefers_2d() const override { return true; }
};
std::unique_ptr<Engine> make_fourier(const std::string&, int threads) {
  return std::make_unique<FourierEngine>(threads);
}
std::unique_ptr<Engine> make_float(const std::string&, int threads) { return std::make_unique<FloatEngine>(threads); }

struct EngineEntry {
  const char* name;
  bool takes_device;  ///< as NAME:DEVICE
  std::unique_ptr<Engine> (*make)(const std::string& device, int threads);
};

constexpr EngineEntry kEngines[] = {{"cpu", false, make_cpu},
                                    {"fourier", false, make_fourier},
                                    {"float", false, make_float},
                                    {"opencl", true, make_opencl_with_fallback}};

// What "auto" stands for, GPU or not: one large GPU was faster, a small one may be slower (doc/reports/performance.md,
// "On a GPU"), OpenCL on the processor is slower, and so is the float engine at every extent.
constexpr const char* kAuto = "cpu";

std::string available_names() {
  std::string names = "auto";
  for (const EngineEntry& entry : kEngines) {
    names += std::string(", ") + entry.name;
    if (entry.takes_device) names += std::string(", ") + entry.name + ":INDEX, " + entry.name + ":NAME";
  }
  return names;
}

}  // namespace

std::unique_ptr<Engine> make_engine(const std::string& engine, int threads) {
  require_range("threads", threads, 0, 256);
  const std::string wanted = engine == "auto" ? kAuto : engine;
  for (const EngineEntry& entry : kEngines) {
    if (wanted == entry.name) return entry.make("", threads);
    const std::string prefix = std::string(entry.name) + ":";
    if (entry.takes_device && wanted.size() > prefix.size() && wanted.compare(0, prefix.size(), prefix) == 0) {
      return entry.make(wanted.substr(prefix.size()), threads);
    }
  }
  throw OptionError("engine = \"" + engine + "\" is unknown; available: " + available_names());
}

}  // namespace gyro_deblur
