// Makes the engine that an option names.
#include <memory>
#include <string>
#include <utility>

#include "base/require_range.hpp"
#include "engine/cpu/cpu_engine.hpp"
#include "engine/engine.hpp"
#include "engine/fallback_engine.hpp"
#include "engine/float/float_engine.hpp"
#include "engine/opencl/opencl_engine.hpp"
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

/// The 2-D filter for all blocks, but for those that come with a 1-D kernel all the same.
class FourierEngine : public CpuEngine {
 public:
  using CpuEngine::CpuEngine;
  std::string name() const override { return "fourier, " + CpuEngine::name(); }
  bool prefers_2d() const override { return true; }
};

}  // namespace

std::unique_ptr<Engine> make_engine(const std::string& engine, int threads) {
  require_range("threads", threads, 0, 256);
  // "auto", GPU or not: one large GPU was faster, a small one may be slower (doc/reports/performance.md, "On a GPU"),
  // OpenCL on the processor is slower, and so is the float engine at every extent.
  if (engine == "auto" || engine == "cpu") return std::make_unique<CpuEngine>(threads);
  if (engine == "fourier") return std::make_unique<FourierEngine>(threads);
  if (engine == "float") return std::make_unique<FloatEngine>(threads);
  if (engine == "opencl") return make_opencl_with_fallback("", threads);
  const std::string with_device = "opencl:";
  if (engine.size() > with_device.size() && engine.rfind(with_device, 0) == 0) {
    return make_opencl_with_fallback(engine.substr(with_device.size()), threads);
  }
  throw OptionError("engine = \"" + engine +
                    "\" is unknown; available: auto, cpu, fourier, float, opencl, opencl:INDEX, opencl:NAME");
}

}  // namespace gyro_deblur
