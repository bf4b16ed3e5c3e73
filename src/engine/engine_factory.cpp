#include <memory>
#include <string>
#include <utility>

#include "engine/cpu/cpu_engine.hpp"
#include "engine/fallback_engine.hpp"
#include "engine/float/float_engine.hpp"
#include "engine/opencl/opencl_factory.hpp"
#include "gyro_deblur/engine.hpp"
#include "gyro_deblur/option_error.hpp"

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
std::unique_ptr<Engine> make_float(const std::string&, int threads) { return std::make_unique<FloatEngine>(threads); }

bool always() { return true; }
bool never() { return false; }

struct EngineEntry {
  const char* name;
  bool takes_device;  ///< as NAME:DEVICE
  bool (*serves_auto)();
  std::unique_ptr<Engine> (*make)(const std::string& device, int threads);
};

// "auto" is the first that serves: OpenCL where there is a GPU, which then has the work (doc/reports/performance.md,
// "On a GPU"), else the cpu engine, since OpenCL on the processor is slower than it. The float engine is slower at
// every extent and serves only who asks for it.
constexpr EngineEntry kEngines[] = {{"opencl", true, opencl_gpu_present, make_opencl_with_fallback},
                                    {"cpu", false, always, make_cpu},
                                    {"float", false, never, make_float}};

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
  for (const EngineEntry& entry : kEngines) {
    if (engine == entry.name || (engine == "auto" && entry.serves_auto())) return entry.make("", threads);
    const std::string prefix = std::string(entry.name) + ":";
    if (entry.takes_device && engine.size() > prefix.size() && engine.compare(0, prefix.size(), prefix) == 0) {
      return entry.make(engine.substr(prefix.size()), threads);
    }
  }
  throw OptionError("engine = \"" + engine + "\" is unknown; available: " + available_names());
}

}  // namespace gyro_deblur
