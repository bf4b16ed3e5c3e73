#include <memory>
#include <string>

#include "engine/cpu/cpu_engine.hpp"
#include "engine/fallback_engine.hpp"
#include "engine/float/float_engine.hpp"
#include "engine/opencl/opencl_factory.hpp"
#include "gyro_deblur/engine.hpp"

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

}  // namespace

std::unique_ptr<Engine> make_engine(const std::string& engine, int threads) {
  require_range("threads", threads, 0, 256);
  if (engine == "float") return std::make_unique<FloatEngine>(threads);
  const bool automatic = engine == "auto";
  if (engine == "opencl" || (automatic && opencl_gpu_present())) return make_opencl_with_fallback("", threads);
  if (engine == "cpu" || automatic) return std::make_unique<CpuEngine>(threads);
  const std::string prefix = "opencl:";
  if (engine.size() > prefix.size() && engine.compare(0, prefix.size(), prefix) == 0) {
    return make_opencl_with_fallback(engine.substr(prefix.size()), threads);
  }
  throw OptionError("engine = \"" + engine +
                    "\" is unknown; available: auto, cpu, reference, opencl, opencl:INDEX, opencl:NAME");
}

}  // namespace gyro_deblur
