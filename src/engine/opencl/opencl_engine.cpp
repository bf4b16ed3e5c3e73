// Filters blocks on an OpenCL device.
#include "engine/opencl/opencl_engine.hpp"

#include <algorithm>
#include <cctype>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <type_traits>

#include "base/parallel.hpp"
#include "engine/block_engine.hpp"
#include "engine/engine.hpp"
#include "engine/fallback_engine.hpp"
#include "engine/opencl/opencl_api.hpp"
#include "engine/opencl/transfer_buffer.hpp"
#include "inverse/line_taps.hpp"

namespace gyro_deblur {

// line_convolution.cl
extern const char kLineConvolutionSource[];

namespace {

// As in line_convolution.cl, where StepTaps is called Step.
static_assert(sizeof(StepTaps) == 3 * sizeof(cl_int) && std::is_same_v<cl_float, float>, "goes to the device as it is");
struct Tile {
  cl_int u, v, cols, rows, first_step, steps, first_m, transposed, to, step_y;
};

// Work-groups of 216 work-items with 8 outputs each, so that a block of 64 px with its margins is three tiles.
constexpr int kGroupCols = 72, kGroupRows = 3, kOutputsPerItem = 8;
constexpr int kGroupTileRows = kGroupRows * kOutputsPerItem;

std::string lower_case(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::tolower(c); });
  return text;
}

struct NamedDevice {
  cl::Device device;
  std::string name;  // "PLATFORM: DEVICE"
  bool is_gpu;
};

/// All devices of all platforms; a platform that fails has none.
std::vector<NamedDevice> all_devices() {
  std::vector<NamedDevice> all;
  std::vector<cl::Platform> platforms;
  try {
    cl::Platform::get(&platforms);
  } catch (const cl::Error&) {
    return all;  // the loader's way to say that there are none
  }
  for (const cl::Platform& platform : platforms) {
    try {
      std::vector<cl::Device> devices;
      platform.getDevices(CL_DEVICE_TYPE_ALL, &devices);
      const std::string prefix = platform.getInfo<CL_PLATFORM_NAME>() + ": ";
      for (const cl::Device& device : devices) {
        const bool is_gpu = (device.getInfo<CL_DEVICE_TYPE>() & CL_DEVICE_TYPE_GPU) != 0;
        all.push_back({device, prefix + device.getInfo<CL_DEVICE_NAME>(), is_gpu});
      }
    } catch (const cl::Error&) {
      continue;
    }
  }
  return all;
}

/// @param wanted  as make_opencl_engine() takes it
/// Throws DeviceError that lists the devices when there is no such one.
cl::Device choose_opencl_device(const std::string& wanted) {
  const std::vector<NamedDevice> all = all_devices();
  if (all.empty()) throw DeviceError("there is no OpenCL device");
  const bool is_index = std::all_of(wanted.begin(), wanted.end(), [](unsigned char c) { return std::isdigit(c); });
  if (wanted.empty()) {
    for (const NamedDevice& candidate : all) {
      if (candidate.is_gpu) return candidate.device;
    }
    return all.front().device;
  }
  std::string names;
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (is_index ? wanted == std::to_string(i)
                 : lower_case(all[i].name).find(lower_case(wanted)) != std::string::npos) {
      return all[i].device;
    }
    names += (i == 0 ? "" : ", ") + std::to_string(i) + " = \"" + all[i].name + "\"";
  }
  throw DeviceError("no OpenCL device \"" + wanted + "\"; there is " + names);
}

/// The same error as the fallback takes it.
DeviceError device_error(const cl::Error& error) {
  return DeviceError(std::string(error.what()) + " returned " + std::to_string(error.err()));
}

std::string one_line(std::string text) {
  constexpr std::size_t kLongest = 400;
  if (text.size() > kLongest) text.resize(kLongest);
  std::replace_if(
      text.begin(), text.end(), [](unsigned char c) { return std::iscntrl(c) != 0; }, ' ');
  return text;
}

/// One channel as float with its border, on the device.
struct Plane {
  bool used = false;
  int stride = 1, rows = 1, border_u = 0, border_v = 0;
  cl::Buffer buffer;
  std::size_t capacity = 0;

  void clear() {
    used = false;
    border_u = border_v = 0;
  }

  /// Makes the border as wide as the line needs.
  void use_for(const LineSteps& line) {
    used = true;
    if (line.steps.empty()) return;
    border_u = std::max({border_u, -line.first_m, line.first_m + static_cast<int>(line.steps.size()) - 1});
    for (const int n : {line.steps.front().across, line.steps.back().across}) {
      border_v = std::max(border_v, std::abs(n) + 1);  // the upper weight's pixel is one further
    }
  }

  /// For an image of size_u x size_v whose steps reach border_u and border_v, with a tile to spare at the far ends.
  void lay_out(const cl::Context& context, int size_u, int size_v) {
    // An odd number of cache lines a row, so that pixels above each other do not compete for the same cache set.
    constexpr std::int64_t kFloatsPerCacheLine = 16;
    const std::int64_t lines = (size_u + 2 * border_u + kGroupCols) / kFloatsPerCacheLine + 1;
    const std::int64_t wide = (lines | 1) * kFloatsPerCacheLine;
    const std::int64_t high = size_v + 2 * border_v + kGroupTileRows;
    if (wide * high > std::numeric_limits<cl_int>::max()) {
      throw DeviceError("the padded image of " + std::to_string(wide) + "x" + std::to_string(high) +
                        " px is too large");
    }
    stride = static_cast<int>(wide);
    rows = static_cast<int>(high);
    const std::size_t bytes = static_cast<std::size_t>(wide * high) * sizeof(cl_float);
    if (bytes <= capacity) return;
    buffer = cl::Buffer();
    buffer = cl::Buffer(context, CL_MEM_READ_WRITE, bytes);
    capacity = bytes;
  }
};

class OpenClEngine : public BlockEngine {
 public:
  // A device on the processor has threads of its own, on the same cores.
  OpenClEngine(const cl::Device& device, int threads, bool pinned)
      : BlockEngine(is_processor(device) ? 1 : threads),
        device_(device),
        name_("opencl (" + device.getInfo<CL_DEVICE_NAME>() + ")"),
        context_(device),
        queue_(context_, device),
        image_(context_, queue_, shares_memory(device, pinned)),
        steps_(context_, queue_, shares_memory(device, pinned)),
        tiles_(context_, queue_, shares_memory(device, pinned)),
        result_(context_, queue_, shares_memory(device, pinned)) {
    program(CV_8U);
  }

  std::string name() const override { return name_; }

 protected:
  void filter_blocks(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks, SeamBlender& seams,
                     cv::Mat& dst) override {
    try {
      start(src, grid, blocks, seams);
      copy_untouched(src, grid, dst);
      finish(blocks, seams, dst);
    } catch (const cl::Error& error) {
      throw device_error(error);
    }
  }

 private:
  struct Program {
    cl::Kernel load_plane, convolve_tiles;
  };

  static bool is_processor(const cl::Device& device) {
    return (device.getInfo<CL_DEVICE_TYPE>() & CL_DEVICE_TYPE_CPU) != 0;
  }
  static bool shares_memory(const cl::Device& device, bool pinned) {
    return !pinned && device.getInfo<CL_DEVICE_HOST_UNIFIED_MEMORY>();
  }

  std::string build_options(int depth) const {
    const bool use_fma = is_processor(device_) && (device_.getInfo<CL_DEVICE_SINGLE_FP_CONFIG>() & CL_FP_FMA) != 0;
    return std::string("-cl-std=CL1.2 -cl-mad-enable") +
           (depth == CV_8U ? " -D PIXEL=uchar -D PIXEL_MAX=255" : " -D PIXEL=ushort -D PIXEL_MAX=65535") +
           " -D ROWS=" + std::to_string(kOutputsPerItem) + " -D GROUP_COLS=" + std::to_string(kGroupCols) +
           " -D GROUP_ROWS=" + std::to_string(kGroupRows) + " -D MULTIPLY_ADD=" + (use_fma ? "fma" : "mad");
  }

  Program& program(int depth) {
    const int slot = depth == CV_8U ? 0 : 1;
    if (built_[slot]) return programs_[slot];
    cl::Program built(context_, std::string(kLineConvolutionSource));
    try {
      built.build({device_}, build_options(depth).c_str());
    } catch (const cl::Error& error) {
      throw DeviceError("building the OpenCL program: error " + std::to_string(error.err()) + ": " +
                        one_line(built.getBuildInfo<CL_PROGRAM_BUILD_LOG>(device_)));
    }
    Program& made = programs_[slot];
    made.load_plane = cl::Kernel(built, "load_plane");
    made.convolve_tiles = cl::Kernel(built, "convolve_tiles");
    constexpr std::size_t kGroupSize = kGroupCols * kGroupRows;
    if (made.convolve_tiles.getWorkGroupInfo<CL_KERNEL_WORK_GROUP_SIZE>(device_) < kGroupSize) {
      throw DeviceError("the device does not take work-groups of " + std::to_string(kGroupSize));
    }
    built_[slot] = true;
    return made;
  }

  /// Lines, tiles and the planes that they need.
  void plan(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks, const SeamBlender& seams) {
    const int count = static_cast<int>(blocks.size());
    lines_.resize(std::max(lines_.size(), blocks.size()));
    parallel_for(count, threads(), 1, [&](int i) {
      const BlockFilter& block = grid.blocks[blocks[i]];
      make_line_steps(*block.kernel, direction_of(block.angle_rad), lines_[i]);
    });

    tile_list_.clear();
    result_starts_.clear();
    step_count_ = result_values_ = 0;
    upright_.clear();
    transposed_.clear();
    for (int i = 0; i < count; ++i) {
      (lines_[i].major_is_y ? transposed_ : upright_).use_for(lines_[i]);
      cut_tiles(lines_[i], seams.reach(blocks[i]), src.channels());
    }
    // The longest first, so that none begins when others end.
    std::stable_sort(tile_list_.begin(), tile_list_.end(),
                     [](const Tile& a, const Tile& b) { return a.steps > b.steps; });
    // A plane that is not used is still an argument of the kernel, and has to exist.
    upright_.lay_out(context_, upright_.used ? src.cols : 1, upright_.used ? src.rows : 1);
    transposed_.lay_out(context_, transposed_.used ? src.rows : 1, transposed_.used ? src.cols : 1);
  }

  /// Appends the tiles, the steps and the results of a block.
  void cut_tiles(const LineSteps& line, const cv::Rect& rect, int channels) {
    const int steps = static_cast<int>(line.steps.size()), step_y = rect.width * channels;
    const int step_u = line.major_is_y ? step_y : channels, step_v = line.major_is_y ? channels : step_y;
    const int start = static_cast<int>(result_values_);
    result_starts_.push_back(result_values_);
    result_values_ += static_cast<std::size_t>(rect.area()) * channels;
    const int u0 = line.major_is_y ? rect.y : rect.x, cols = line.major_is_y ? rect.height : rect.width;
    const int v0 = line.major_is_y ? rect.x : rect.y, rows = line.major_is_y ? rect.width : rect.height;
    for (int v = 0; v < rows; v += kGroupTileRows) {
      for (int u = 0; u < cols; u += kGroupCols) {
        tile_list_.push_back({u0 + u, v0 + v, std::min(kGroupCols, cols - u), std::min(kGroupTileRows, rows - v),
                              static_cast<cl_int>(step_count_), steps, line.first_m, line.major_is_y ? 1 : 0,
                              start + v * step_v + u * step_u, step_y});
      }
    }
    step_count_ += line.steps.size();
  }

  /// Steps of `count` lines, and tiles.
  void upload_plan(int count) {
    steps_.upload(std::max<std::size_t>(step_count_, 1) * sizeof(StepTaps), [&](void* host) {
      StepTaps* to = static_cast<StepTaps*>(host);
      for (int i = 0; i < count; ++i) to = std::copy(lines_[i].steps.begin(), lines_[i].steps.end(), to);
    });
    tiles_.upload(tile_list_.size() * sizeof(Tile),
                  [&](void* host) { std::memcpy(host, tile_list_.data(), tile_list_.size() * sizeof(Tile)); });
  }

  void load(Program& program, const cv::Mat& src, int channel, Plane& plane, bool transposed) {
    const int step_x = src.channels(), step_y = src.cols * src.channels();
    cl::Kernel& kernel = program.load_plane;
    int index = 0;
    kernel.setArg(index++, image_.device());
    for (const cl_int argument : {channel, transposed ? step_y : step_x, transposed ? step_x : step_y,
                                  transposed ? src.rows : src.cols, transposed ? src.cols : src.rows}) {
      kernel.setArg(index++, argument);
    }
    kernel.setArg(index++, plane.buffer);
    for (const cl_int argument : {plane.stride, plane.rows, plane.border_u, plane.border_v}) {
      kernel.setArg(index++, argument);
    }
    constexpr int kGroupSide = 16;
    const auto whole_groups = [](int length) {
      return static_cast<std::size_t>((length + kGroupSide - 1) / kGroupSide * kGroupSide);
    };
    queue_.enqueueNDRangeKernel(kernel, cl::NullRange,
                                cl::NDRange(whole_groups(plane.stride), whole_groups(plane.rows)),
                                cl::NDRange(kGroupSide, kGroupSide));
  }

  void convolve(Program& program, int channel, int channels) {
    cl::Kernel& kernel = program.convolve_tiles;
    int index = 0;
    kernel.setArg(index++, tiles_.device());
    kernel.setArg(index++, steps_.device());
    for (const Plane* plane : {&upright_, &transposed_}) {
      kernel.setArg(index++, plane->buffer);
      for (const cl_int argument : {plane->stride, plane->border_u, plane->border_v}) kernel.setArg(index++, argument);
    }
    kernel.setArg(index++, result_.device());
    for (const cl_int argument : {channel, channels}) kernel.setArg(index++, argument);
    queue_.enqueueNDRangeKernel(kernel, cl::NullRange, cl::NDRange(tile_list_.size() * kGroupCols, kGroupRows),
                                cl::NDRange(kGroupCols, kGroupRows));
  }

  /// Has the device begin with a frame.
  void start(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks, const SeamBlender& seams) {
    if (blocks.empty()) return;
    Program& kernels = program(src.depth());
    // First: a driver may begin the transfer during the rest.
    image_.upload(src.total() * src.elemSize(), [&](void* host) { src.copyTo(cv::Mat(src.size(), src.type(), host)); });
    plan(src, grid, blocks, seams);
    upload_plan(static_cast<int>(blocks.size()));
    result_.reserve(result_values_ * src.elemSize1());
    for (int channel = 0; channel < src.channels(); ++channel) {
      if (upright_.used) load(kernels, src, channel, upright_, false);
      if (transposed_.used) load(kernels, src, channel, transposed_, true);
      convolve(kernels, channel, src.channels());
    }
    queue_.flush();
  }

  /// Waits for the device and stores what it was started with.
  void finish(const std::vector<int>& blocks, SeamBlender& seams, cv::Mat& dst) {
    if (blocks.empty()) return;
    result_.download(result_values_ * dst.elemSize1(), [&](void* host) {
      constexpr int kBlocksAtATime = 8;
      parallel_for(static_cast<int>(blocks.size()), threads(), kBlocksAtATime, [&](int i) {
        uchar* result = static_cast<uchar*>(host) + result_starts_[i] * dst.elemSize1();
        seams.store(blocks[i], cv::Mat(seams.reach(blocks[i]).size(), dst.type(), result), dst);
      });
    });
  }

  cl::Device device_;
  std::string name_;
  cl::Context context_;
  cl::CommandQueue queue_;
  Program programs_[2];  // 8 and 16 bit, built on first use
  bool built_[2] = {false, false};
  TransferBuffer image_, steps_, tiles_, result_;
  Plane upright_, transposed_;
  // Of the current frame; members to reuse their memory.
  std::vector<LineSteps> lines_;            // of the blocks that are filtered
  std::vector<std::size_t> result_starts_;  // of them, in result_ [values]
  std::size_t result_values_ = 0;
  std::vector<Tile> tile_list_;
  std::size_t step_count_ = 0;
};

}  // namespace

std::vector<std::string> opencl_devices() {
  std::vector<std::string> names;
  for (const NamedDevice& found : all_devices()) names.push_back(found.name);
  return names;
}

std::unique_ptr<Engine> make_opencl_engine(const std::string& device, int threads, bool pinned) {
  try {
    return std::make_unique<OpenClEngine>(choose_opencl_device(device), threads, pinned);
  } catch (const cl::Error& error) {
    throw device_error(error);
  }
}

}  // namespace gyro_deblur
