#include "engine/opencl/opencl_engine.hpp"

#include <omp.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstring>
#include <limits>
#include <utility>

#define CL_TARGET_OPENCL_VERSION 120
#define CL_HPP_TARGET_OPENCL_VERSION 120
#define CL_HPP_MINIMUM_OPENCL_VERSION 120
#define CL_HPP_ENABLE_EXCEPTIONS
#if __has_include(<CL/opencl.hpp>)
#include <CL/opencl.hpp>
#else
#include <CL/cl2.hpp>
#endif

#include "base/parallel.hpp"
#include "engine/fallback_engine.hpp"
#include "engine/filter_grid.hpp"
#include "engine/opencl/opencl_factory.hpp"
#include "engine/seam_blender.hpp"
#include "inverse/line_taps.hpp"

namespace gyro_deblur {

// line_convolution.cl
extern const char kLineConvolutionSource[];

namespace {

// As in line_convolution.cl.
struct Step {
  cl_int across;
  cl_float lower, upper;
};
struct Tile {
  cl_int u, v, cols, rows, first_step, steps, first_m, transposed, to, step_y;
};

/// The steps of one block's line: of m, m + 1, ...
struct Line {
  bool major_is_y = false;
  int first_m = 0;
  std::vector<Step> steps;
};

/// Shape of the work, see line_convolution.cl.
struct Shape {
  int lanes, vectors, rows, group_cols, group_rows, tile_cols, tile_rows, stage_steps;
  int patch, patch_group;  // of load_plane: side of a work-item's square, work-items on a side of a work-group
  bool use_fma;

  std::string build_options() const {
    const std::pair<const char*, int> macros[] = {
        {"LANES", lanes},           {"VECTORS", vectors},         {"ROWS", rows},
        {"GROUP_COLS", group_cols}, {"GROUP_ROWS", group_rows},   {"TILE_COLS", tile_cols},
        {"TILE_ROWS", tile_rows},   {"STAGE_STEPS", stage_steps}, {"PATCH", patch}};
    std::string options = "-cl-std=CL1.2 -cl-mad-enable";
    for (const auto& [name, value] : macros) options += std::string(" -D ") + name + "=" + std::to_string(value);
    return options + " -D MULTIPLY_ADD=" + (use_fma ? "fma" : "mad");
  }
};

// 216 work-items of 8 outputs, so that a block of 64 px with its margins is three tiles; 23 KiB of staged input serve
// 32 steps, 18 multiply-adds for every float staged.
constexpr Shape kGpuShape{1, 1, 8, 72, 3, 72, 24, 32, 1, 16, false};

/// As many sums as the vector registers hold beside the pixels: 8 x 3 of 32 registers, 4 x 3 of 16. Three vectors of 8
/// divide the 72 px of a block and its margins.
Shape cpu_shape(const cl::Device& device) {
  const int native = static_cast<int>(device.getInfo<CL_DEVICE_NATIVE_VECTOR_WIDTH_FLOAT>());
  const bool has_fma = (device.getInfo<CL_DEVICE_SINGLE_FP_CONFIG>() & CL_FP_FMA) != 0;
  const int lanes = native >= 8 ? 8 : 4;
  return {lanes, 3, native >= 16 ? 8 : 4, 1, 1, 72, 72, 0, 32, 1, has_fma};
}

std::string one_line(std::string text) {
  constexpr std::size_t kLongest = 400;
  if (text.size() > kLongest) text.resize(kLongest);
  std::replace_if(
      text.begin(), text.end(), [](unsigned char c) { return std::iscntrl(c) != 0; }, ' ');
  return text;
}

DeviceError device_error(const cl::Error& error) {
  return DeviceError(std::string(error.what()) + " returned " + std::to_string(error.err()));
}

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

cl::Device choose_device(const std::string& wanted) {
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

double duration_ms(const cl::Event& event) {
  constexpr double kNsPerMs = 1e6;
  return static_cast<double>(event.getProfilingInfo<CL_PROFILING_COMMAND_END>() -
                             event.getProfilingInfo<CL_PROFILING_COMMAND_START>()) /
         kNsPerMs;
}

double duration_ms(const std::vector<cl::Event>& events) {
  double sum = 0;
  for (const cl::Event& event : events) sum += duration_ms(event);
  return sum;
}

/// Device memory that grows to the largest size asked for. With shared memory the host maps it; otherwise it goes
/// through pinned memory that stays mapped.
class TransferBuffer {
 public:
  TransferBuffer(cl::Context context, cl::CommandQueue queue, bool shared_memory)
      : context_(std::move(context)), queue_(std::move(queue)), shared_memory_(shared_memory) {}
  ~TransferBuffer() { release(); }
  TransferBuffer(const TransferBuffer&) = delete;
  TransferBuffer& operator=(const TransferBuffer&) = delete;

  const cl::Buffer& device() const { return device_; }

  void reserve(std::size_t bytes) {
    if (bytes <= capacity_) return;
    release();
    device_ = cl::Buffer(context_, CL_MEM_READ_WRITE | (shared_memory_ ? CL_MEM_ALLOC_HOST_PTR : 0), bytes);
    if (!shared_memory_) {
      pinned_ = cl::Buffer(context_, CL_MEM_READ_WRITE | CL_MEM_ALLOC_HOST_PTR, bytes);
      host_ = queue_.enqueueMapBuffer(pinned_, CL_TRUE, CL_MAP_READ | CL_MAP_WRITE, 0, bytes);
    }
    capacity_ = bytes;
  }

  /// Has `fill(void*)` write `bytes` and takes them to the device.
  template <typename Fill>
  void upload(std::size_t bytes, std::vector<cl::Event>* events, const Fill& fill) {
    reserve(bytes);
    events->emplace_back();
    if (shared_memory_) {
      void* host =
          queue_.enqueueMapBuffer(device_, CL_TRUE, CL_MAP_WRITE_INVALIDATE_REGION, 0, bytes, nullptr, &events->back());
      fill(host);
      events->emplace_back();
      queue_.enqueueUnmapMemObject(device_, host, nullptr, &events->back());
    } else {
      fill(host_);
      queue_.enqueueWriteBuffer(device_, CL_FALSE, 0, bytes, host_, nullptr, &events->back());
    }
  }

  /// Waits for the device and has `read(const void*)` take `bytes`.
  template <typename Read>
  void download(std::size_t bytes, std::vector<cl::Event>* events, const Read& read) {
    events->emplace_back();
    if (shared_memory_) {
      void* host = queue_.enqueueMapBuffer(device_, CL_TRUE, CL_MAP_READ, 0, bytes, nullptr, &events->back());
      read(host);
      queue_.enqueueUnmapMemObject(device_, host);
    } else {
      queue_.enqueueReadBuffer(device_, CL_TRUE, 0, bytes, host_, nullptr, &events->back());
      read(host_);
    }
  }

 private:
  void release() noexcept {
    // Through the C interface: nothing can be done about an error here.
    if (host_ != nullptr) clEnqueueUnmapMemObject(queue_(), pinned_(), host_, 0, nullptr, nullptr);
    host_ = nullptr;
    pinned_ = device_ = cl::Buffer();
    capacity_ = 0;
  }

  cl::Context context_;
  cl::CommandQueue queue_;
  bool shared_memory_;
  cl::Buffer device_, pinned_;
  void* host_ = nullptr;  // of pinned_
  std::size_t capacity_ = 0;
};

/// One channel as float with its border, on the device.
struct Plane {
  bool used = false;
  int stride = 1, rows = 1, border_u = 0, border_v = 0;
  cl::Buffer buffer;
  std::size_t capacity = 0;

  /// For an image of size_u x size_v whose steps reach border_u and border_v, with a tile to spare at the far ends.
  void layout(const cl::Context& context, const Shape& shape, int size_u, int size_v) {
    // An odd number of cache lines a row, so that pixels above each other do not compete for the same cache set.
    constexpr std::int64_t kFloatsPerCacheLine = 16;
    const std::int64_t lines = (size_u + 2 * border_u + shape.tile_cols) / kFloatsPerCacheLine + 1;
    const std::int64_t wide = (lines | 1) * kFloatsPerCacheLine;
    const std::int64_t high = size_v + 2 * border_v + shape.tile_rows;
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

/// rotate_kernel's taps by step of the major axis; at each there are at most two, neighbours across.
void set_line(const BlockFilter& block, Line* line) {
  line->steps.clear();
  line->first_m = 0;
  line->major_is_y = std::abs(std::sin(block.angle_rad)) > std::abs(std::cos(block.angle_rad));
  for (const KernelTap& tap : rotate_kernel(*block.kernel, block.angle_rad)) {
    const int m = line->major_is_y ? tap.dy : tap.dx;
    const int n = line->major_is_y ? tap.dx : tap.dy;
    if (line->steps.empty()) line->first_m = m;
    const int step = m - line->first_m;
    // Steps without taps stay with their neighbour.
    while (static_cast<int>(line->steps.size()) < step) {
      line->steps.push_back({line->steps.back().across, 0, 0});
    }
    if (static_cast<int>(line->steps.size()) == step) {
      line->steps.push_back({n, tap.weight, 0});
    } else {
      line->steps.back().upper = tap.weight;
    }
  }
}

}  // namespace

class OpenClEngine::Impl {
 public:
  Impl(const cl::Device& device, int threads, OpenClTuning tuning)
      : device_(device),
        name_("opencl (" + device.getInfo<CL_DEVICE_NAME>() + ")"),
        shape_(use_gpu_shape(device, tuning) ? kGpuShape : cpu_shape(device)),
        threads_(threads),
        context_(device),
        queue_(context_, device, CL_QUEUE_PROFILING_ENABLE),
        image_(context_, queue_, shares_memory(device, tuning)),
        steps_(context_, queue_, shares_memory(device, tuning)),
        tiles_(context_, queue_, shares_memory(device, tuning)),
        result_(context_, queue_, shares_memory(device, tuning)) {
    program(CV_8U);
  }

  void filter(const cv::Mat& src, const FilterGrid& grid, cv::Mat& dst);
  const std::string& name() const { return name_; }
  const OpenClTimes& times() const { return times_; }

 private:
  struct Program {
    cl::Kernel load_plane, convolve_tiles;
  };

  static bool use_gpu_shape(const cl::Device& device, OpenClTuning tuning) {
    if (tuning != OpenClTuning::DEVICE) return tuning == OpenClTuning::GPU;
    return (device.getInfo<CL_DEVICE_TYPE>() & CL_DEVICE_TYPE_CPU) == 0;
  }
  static bool shares_memory(const cl::Device& device, OpenClTuning tuning) {
    return tuning != OpenClTuning::GPU && device.getInfo<CL_DEVICE_HOST_UNIFIED_MEMORY>();
  }

  Program& program(int depth);
  // A device on the processor has threads of its own, which OpenMP threads waiting for their next work would keep from
  // running: a third of the time of a short kernel.
  int threads() const {
    if ((device_.getInfo<CL_DEVICE_TYPE>() & CL_DEVICE_TYPE_CPU) != 0) return 1;
    return threads_ > 0 ? threads_ : omp_get_max_threads();
  }
  void plan(const cv::Mat& src, const FilterGrid& grid);
  template <typename Pixel>
  void store_results(const FilterGrid& grid, const void* results, cv::Mat& dst);
  void load(Program& program, const cv::Mat& src, int channel, Plane& plane, bool transposed);

  cl::Device device_;
  std::string name_;
  Shape shape_;
  int threads_;
  cl::Context context_;
  cl::CommandQueue queue_;
  Program programs_[2];  // 8 and 16 bit, built on first use
  bool built_[2] = {false, false};
  TransferBuffer image_, steps_, tiles_, result_;
  Plane upright_, transposed_;
  // Of the frame at hand; kept for their memory.
  SeamBlender seams_;
  std::vector<Line> lines_;                 // by block
  std::vector<std::size_t> result_starts_;  // by block, in result_ [values]
  std::size_t result_values_ = 0;
  std::vector<Tile> tile_list_;
  std::size_t step_count_ = 0;
  std::vector<cl::Event> upload_events_, kernel_events_, download_events_;
  OpenClTimes times_;
};

OpenClEngine::Impl::Program& OpenClEngine::Impl::program(int depth) {
  const int slot = depth == CV_8U ? 0 : 1;
  if (built_[slot]) return programs_[slot];
  const std::string options = shape_.build_options() + (depth == CV_8U ? " -D PIXEL=uchar -D PIXEL_MAX=255"
                                                                       : " -D PIXEL=ushort -D PIXEL_MAX=65535");
  cl::Program built(context_, std::string(kLineConvolutionSource));
  try {
    built.build({device_}, options.c_str());
  } catch (const cl::Error& error) {
    throw DeviceError("building the OpenCL program: error " + std::to_string(error.err()) + ": " +
                      one_line(built.getBuildInfo<CL_PROGRAM_BUILD_LOG>(device_)));
  }
  Program& made = programs_[slot];
  made.load_plane = cl::Kernel(built, "load_plane");
  made.convolve_tiles = cl::Kernel(built, "convolve_tiles");
  const std::size_t group = static_cast<std::size_t>(shape_.group_cols) * shape_.group_rows;
  if (made.convolve_tiles.getWorkGroupInfo<CL_KERNEL_WORK_GROUP_SIZE>(device_) < group) {
    throw DeviceError("the device does not take work-groups of " + std::to_string(group));
  }
  built_[slot] = true;
  return made;
}

/// Lines, tiles and the planes that they need.
void OpenClEngine::Impl::plan(const cv::Mat& src, const FilterGrid& grid) {
  const std::vector<BlockFilter>& blocks = grid.blocks;
  const int count = static_cast<int>(blocks.size());
  lines_.resize(std::max(lines_.size(), blocks.size()));
  seams_.plan(grid, src.type());
  result_starts_.resize(blocks.size());
  result_values_ = 0;
  run_parallel(count, threads(), 1, [&](int i) {
    if (blocks[i].kernel != nullptr) set_line(blocks[i], &lines_[i]);
  });

  tile_list_.clear();
  step_count_ = 0;
  for (Plane* plane : {&upright_, &transposed_}) {
    plane->used = false;
    plane->border_u = plane->border_v = 0;
  }
  for (int i = 0; i < count; ++i) {
    if (blocks[i].kernel == nullptr) continue;
    const Line& line = lines_[i];
    const int steps = static_cast<int>(line.steps.size());
    Plane& plane = line.major_is_y ? transposed_ : upright_;
    plane.used = true;
    if (steps > 0) {
      plane.border_u = std::max({plane.border_u, -line.first_m, line.first_m + steps - 1});
      for (const int n : {line.steps.front().across, line.steps.back().across}) {
        plane.border_v = std::max(plane.border_v, std::abs(n) + 1);  // the upper weight's pixel is one further
      }
    }
    const cv::Rect rect = seams_.reach(i);
    const int channels = src.channels(), step_y = rect.width * channels;
    const int step_u = line.major_is_y ? step_y : channels, step_v = line.major_is_y ? channels : step_y;
    const int start = static_cast<int>(result_values_);
    result_starts_[i] = result_values_;
    result_values_ += static_cast<std::size_t>(rect.area()) * channels;
    const int u0 = line.major_is_y ? rect.y : rect.x, cols = line.major_is_y ? rect.height : rect.width;
    const int v0 = line.major_is_y ? rect.x : rect.y, rows = line.major_is_y ? rect.width : rect.height;
    for (int v = 0; v < rows; v += shape_.tile_rows) {
      for (int u = 0; u < cols; u += shape_.tile_cols) {
        tile_list_.push_back({u0 + u, v0 + v, std::min(shape_.tile_cols, cols - u),
                              std::min(shape_.tile_rows, rows - v), static_cast<cl_int>(step_count_), steps,
                              line.first_m, line.major_is_y ? 1 : 0, start + v * step_v + u * step_u, step_y});
      }
    }
    step_count_ += line.steps.size();
  }
  // A plane that is not used is still an argument of the kernel, and has to exist.
  upright_.layout(context_, shape_, upright_.used ? src.cols : 1, upright_.used ? src.rows : 1);
  transposed_.layout(context_, shape_, transposed_.used ? src.rows : 1, transposed_.used ? src.cols : 1);
}

void OpenClEngine::Impl::load(Program& program, const cv::Mat& src, int channel, Plane& plane, bool transposed) {
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
  const auto groups = [&](int length) {
    const int span = shape_.patch * shape_.patch_group;
    return static_cast<std::size_t>((length + span - 1) / span * shape_.patch_group);
  };
  kernel_events_.emplace_back();
  queue_.enqueueNDRangeKernel(kernel, cl::NullRange, cl::NDRange(groups(plane.stride), groups(plane.rows)),
                              cl::NDRange(shape_.patch_group, shape_.patch_group), nullptr, &kernel_events_.back());
}

template <typename Pixel>
void OpenClEngine::Impl::store_results(const FilterGrid& grid, const void* results, cv::Mat& dst) {
  const int count = static_cast<int>(grid.blocks.size());
#pragma omp parallel for num_threads(threads()) schedule(static)
  for (int i = 0; i < count; ++i) {
    if (grid.blocks[i].kernel == nullptr) continue;
    seams_.store(i, static_cast<const Pixel*>(results) + result_starts_[i], dst);
  }
}

void OpenClEngine::Impl::filter(const cv::Mat& src, const FilterGrid& grid, cv::Mat& dst) {
  const std::vector<BlockFilter>& blocks = grid.blocks;
  dst.create(src.size(), src.type());
  times_ = {};
  plan(src, grid);
  const auto copy_unfiltered = [&] {
    for (std::size_t i = 0; i < blocks.size(); ++i) {
      const cv::Rect rect = grid.rect(static_cast<int>(i));
      if (blocks[i].kernel == nullptr) src(rect).copyTo(dst(rect));
    }
  };
  if (tile_list_.empty()) return copy_unfiltered();

  for (std::vector<cl::Event>* events : {&upload_events_, &kernel_events_, &download_events_}) events->clear();
  Program& kernels = program(src.depth());
  const std::size_t image_bytes = src.total() * src.elemSize();
  image_.upload(image_bytes, &upload_events_, [&](void* host) { src.copyTo(cv::Mat(src.size(), src.type(), host)); });
  steps_.upload(std::max<std::size_t>(step_count_, 1) * sizeof(Step), &upload_events_, [&](void* host) {
    Step* to = static_cast<Step*>(host);
    for (std::size_t i = 0; i < blocks.size(); ++i) {
      if (blocks[i].kernel != nullptr) to = std::copy(lines_[i].steps.begin(), lines_[i].steps.end(), to);
    }
  });
  tiles_.upload(tile_list_.size() * sizeof(Tile), &upload_events_,
                [&](void* host) { std::memcpy(host, tile_list_.data(), tile_list_.size() * sizeof(Tile)); });
  const std::size_t result_bytes = result_values_ * src.elemSize1();
  result_.reserve(result_bytes);

  for (int channel = 0; channel < src.channels(); ++channel) {
    if (upright_.used) load(kernels, src, channel, upright_, false);
    if (transposed_.used) load(kernels, src, channel, transposed_, true);
    cl::Kernel& kernel = kernels.convolve_tiles;
    int index = 0;
    kernel.setArg(index++, tiles_.device());
    kernel.setArg(index++, steps_.device());
    for (const Plane* plane : {&upright_, &transposed_}) {
      kernel.setArg(index++, plane->buffer);
      for (const cl_int argument : {plane->stride, plane->border_u, plane->border_v}) kernel.setArg(index++, argument);
    }
    kernel.setArg(index++, result_.device());
    for (const cl_int argument : {channel, src.channels()}) kernel.setArg(index++, argument);
    kernel_events_.emplace_back();
    queue_.enqueueNDRangeKernel(kernel, cl::NullRange,
                                cl::NDRange(tile_list_.size() * shape_.group_cols, shape_.group_rows),
                                cl::NDRange(shape_.group_cols, shape_.group_rows), nullptr, &kernel_events_.back());
  }
  queue_.flush();
  copy_unfiltered();
  result_.download(result_bytes, &download_events_, [&](const void* host) {
    if (src.depth() == CV_8U) {
      store_results<cl_uchar>(grid, host, dst);
    } else {
      store_results<cl_ushort>(grid, host, dst);
    }
  });
  seams_.blend(src, threads(), dst);
  times_ = {duration_ms(upload_events_), duration_ms(kernel_events_), duration_ms(download_events_)};
}

OpenClEngine::OpenClEngine(const std::string& device, int threads, OpenClTuning tuning) {
  try {
    engine_ = std::make_unique<Impl>(choose_device(device), threads, tuning);
  } catch (const cl::Error& error) {
    throw device_error(error);
  }
}

OpenClEngine::~OpenClEngine() = default;

void OpenClEngine::filter(const cv::Mat& src, const FilterGrid& grid, cv::Mat& dst) {
  require_filterable(src, grid);
  try {
    engine_->filter(src, grid, dst);
  } catch (const cl::Error& error) {
    throw device_error(error);
  }
}

std::string OpenClEngine::name() const { return engine_->name(); }

const OpenClTimes& OpenClEngine::last_times() const { return engine_->times(); }

std::vector<std::string> opencl_devices() {
  std::vector<std::string> names;
  for (const NamedDevice& found : all_devices()) names.push_back(found.name);
  return names;
}

bool opencl_gpu_present() {
  const std::vector<NamedDevice> all = all_devices();
  return std::any_of(all.begin(), all.end(), [](const NamedDevice& found) { return found.is_gpu; });
}

std::unique_ptr<Engine> make_opencl_engine(const std::string& device, int threads) {
  return std::make_unique<OpenClEngine>(device, threads);
}

}  // namespace gyro_deblur
