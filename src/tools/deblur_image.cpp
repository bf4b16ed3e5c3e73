// Deblurs one image with a known blur.

#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/imgcodecs.hpp>

#include "base/require_range.hpp"
#include "blur/blur_validation.hpp"
#include "blur/frame_quality.hpp"
#include "blur/image_noise.hpp"
#include "engine/engine.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "gyro_deblur/overlay.hpp"
#include "gyro_deblur/pixel_mask.hpp"
#include "inverse/filter_bank.hpp"
#include "mask_file/mask_file.hpp"
#include "pipeline/deconvolution.hpp"
#include "tools/output_file.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur {
namespace {

struct Arguments {
  std::string input, output, mask, overlay;
  CommonArguments common;
  double angle_deg = 0;
  double extent_px = 0;
  std::vector<std::string> field;  // empty: uniform blur
  double field_offset = 0;
  BlurFieldOptions blur_field;
  ValidationOptions validation;
  FilterOptions filter;
  std::string engine = "auto";
  int significant_bits = 0;
  int threads = 0;
};

std::string lower_extension(const std::string& path) {
  std::string extension = std::filesystem::path(path).extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  return extension;
}

void require_readable(const std::string& path) {
  if (!std::filesystem::is_regular_file(path)) throw std::runtime_error(path + ": no such file");
  if (!std::ifstream(path)) throw std::runtime_error(path + ": cannot be read: check its permissions");
}

cv::Mat read_image(const std::string& path) {
  require_readable(path);
  cv::Mat image;
  try {
    image = cv::imread(path, cv::IMREAD_UNCHANGED);
  } catch (const cv::Exception&) {
    // Sizes beyond OpenCV's limit; its message names neither file nor limit.
  }
  if (image.empty()) throw std::runtime_error(path + ": not an image that can be read; give a PNG, JPEG or TIFF");
  return image;
}

void write_image(const std::string& path, const cv::Mat& image) {
  if (!cv::haveImageWriter(path))
    throw std::runtime_error(path +
                             ": its extension names no image format that can be written; use .png, .jpg or .tif");
  const std::string extension = lower_extension(path);
  const bool is_jpeg = extension == ".jpg" || extension == ".jpeg";
  if (is_jpeg && (image.depth() != CV_8U || image.channels() == 4)) {
    throw std::runtime_error(path + ": JPEG holds neither 16 bit nor alpha; choose PNG or TIFF");
  }
  if (!cv::imwrite(path, image))
    throw std::runtime_error(path + ": cannot be written: check folder, permissions and free space");
}

PixelLayout layout_of(const cv::Mat& image, const std::string& path) {
  if (image.depth() != CV_8U && image.depth() != CV_16U) {
    throw std::runtime_error(path + ": has neither 8 nor 16 bits a channel, no other depth is possible: convert it");
  }
  switch (image.channels()) {
    case 1:
      return PixelLayout::GRAY;
    case 3:
      return PixelLayout::BGR;
    case 4:
      return PixelLayout::BGRA;
    default:
      throw std::runtime_error(path + ": has " + std::to_string(image.channels()) +
                               " channels; 1, 3 or 4 are possible: convert it");
  }
}

/// Rows of numbers with commas, semicolons or white space between them; "nan" marks an unknown cell.
cv::Mat read_csv(const std::string& path) {
  require_readable(path);
  std::ifstream file(path);
  cv::Mat matrix;
  std::string line;
  for (int number = 1; std::getline(file, line); ++number) {
    std::replace_if(
        line.begin(), line.end(), [](char c) { return c == ',' || c == ';'; }, ' ');
    std::istringstream cells(line);
    std::vector<double> row;
    for (std::string cell; cells >> cell;) {
      std::size_t parsed = 0;
      try {
        row.push_back(std::stod(cell, &parsed));
      } catch (const std::logic_error&) {
      }
      if (parsed != cell.size()) {
        throw std::runtime_error(path + ", line " + std::to_string(number) + ": \"" + cell + "\" is not a number");
      }
    }
    if (row.empty()) continue;
    if (!matrix.empty() && static_cast<int>(row.size()) != matrix.cols) {
      throw std::runtime_error(path + ", line " + std::to_string(number) + ": has " + std::to_string(row.size()) +
                               " values where the lines before have " + std::to_string(matrix.cols));
    }
    matrix.push_back(cv::Mat(row, true).reshape(1, 1));
  }
  if (matrix.empty())
    throw std::runtime_error(path + ": holds no numbers; give rows of numbers [px], separated by commas or blanks");
  return matrix;
}

/// A matrix of displacements [px] from text, or from a one-channel image.
cv::Mat read_displacement(const std::string& path, double offset) {
  const std::string extension = lower_extension(path);
  cv::Mat matrix;
  if (extension == ".csv" || extension == ".txt") {
    matrix = read_csv(path);
  } else {
    const cv::Mat image = read_image(path);
    if (image.channels() != 1)
      throw std::runtime_error(path + ": a displacement map has one channel, this image has " +
                               std::to_string(image.channels()));
    image.convertTo(matrix, CV_64F);
  }
  return matrix - offset;
}

/// The blur that the arguments describe.
FrameBlur given_field(const Arguments& arguments, const cv::Size& size) {
  if (!arguments.field.empty()) {
    return blur_field_from_displacement(
        size.width, size.height, read_displacement(arguments.field[0], arguments.field_offset),
        read_displacement(arguments.field[1], arguments.field_offset), arguments.blur_field);
  }
  if (!std::isfinite(arguments.angle_deg)) {
    throw OptionError("--angle-deg = " + std::to_string(arguments.angle_deg) + " is not a finite number");
  }
  require_range("--extent-px", arguments.extent_px, 0, kMaxKernelExtentPx, "px");
  return uniform_blur_field(size.width, size.height, arguments.angle_deg * CV_PI / 180, arguments.extent_px,
                            arguments.blur_field);
}

void run(const Arguments& arguments) {
  const cv::Mat image = read_image(arguments.input);
  const PixelLayout layout = layout_of(image, arguments.input);
  FrameBlur field = given_field(arguments, image.size());
  const PixelMask mask = arguments.mask.empty() ? PixelMask() : load_mask(arguments.mask);
  if (!mask.empty() && mask.size() != image.size()) {
    throw std::runtime_error("--mask " + arguments.mask + " has " + std::to_string(mask.size().width) + "x" +
                             std::to_string(mask.size().height) + " px, the image has " + std::to_string(image.cols) +
                             "x" + std::to_string(image.rows) + " px: give a mask of the image's size");
  }
  const auto engine = make_engine(arguments.engine, arguments.threads);
  mark_masked(mask, &field);
  mark_static_edges(mask, {arguments.filter.length_factor, engine->prefers_2d()}, &field);
  BitDepth depth(arguments.significant_bits);
  const int bits = depth.of(image, layout);
  if (const std::string message = depth.take_message(); !message.empty()) std::cerr << "warning: " << message << "\n";
  const cv::Mat luminance = luminance8(image, layout, bits);
  field = validate_blur_field(field, luminance, arguments.validation);
  field.noise = image_noise(image, layout, bits, 1, mask);

  const FilterBank bank(arguments.filter);
  adapt_regularization(luminance, bank, field, 0, mask);
  cv::Mat deblurred;
  const auto start = std::chrono::steady_clock::now();
  deconvolve(image, layout, field, bank, *engine, deblurred);
  keep_range(image, bits, deblurred);
  const double deconvolution_ms =
      std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();

  if (const std::string warning = engine->take_warning(); !warning.empty()) std::cerr << "warning: " << warning << "\n";

  write_image(arguments.output, deblurred);
  if (!arguments.overlay.empty()) write_image(arguments.overlay, draw_overlay(luminance, field));

  nlohmann::json counts;
  for (const BlockStatus status : kBlockStatuses) counts[to_string(status)] = field.count(status);
  write_json(arguments.common.json, {{"input", arguments.input},
                                     {"output", arguments.output},
                                     {"width", image.cols},
                                     {"height", image.rows},
                                     {"engine", engine->name()},
                                     {"noise_to_signal_ratio", arguments.filter.noise_to_signal_ratio},
                                     {"blocks", counts},
                                     {"median_extent_px", median_extent_px(field, has_known_blur)},
                                     {"deconvolution_ms", deconvolution_ms}});

  std::cout << arguments.output << ": " << field.count(BlockStatus::DEBLURRED) << " of " << field.blocks.size()
            << " blocks deblurred";
  for (const auto& [status, count] : counts.items()) {
    if (status != to_string(BlockStatus::DEBLURRED) && count > 0) std::cout << ", " << count << " " << status;
  }
  std::cout << "\n";
}

int main_of(int argc, char** argv) {
  // One clear line on bad input is this tool's promise; OpenCV would add its own.
  cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);

  Arguments arguments;
  CommandLine app{
      "Deblurs an image whose motion blur is known. Give one blur for the whole image (--angle-deg, --extent-px) or a "
      "field of displacements (--field). 8 and 16 bit, grey, colour and alpha; pixels are taken as stored (EXIF "
      "orientation is not applied).",
      "deblur_image"};
  app.add_option("input", arguments.input, "image to deblur").required();
  app.add_option("output", arguments.output, "where to write the deblurred image").required();
  const auto& angle =
      app.add_option("--angle-deg", arguments.angle_deg, "direction of the motion [deg], x right, y down");
  const auto& extent = app.add_option("--extent-px", arguments.extent_px, "length of the motion [px]");
  const auto& field =
      app.add_option("--field", arguments.field,
                     "matrices of the displacement from start to end of exposure [px], x right, y down: "
                     "DX.csv DY.csv, or one-channel images; any number of rows and columns that cover the "
                     "image evenly; nan: unknown")
          .values(2);
  const auto& field_offset =
      app.add_option("--field-offset", arguments.field_offset, "value of --field that means no displacement")
          .show_default();
  app.add_option("--noise-to-signal-ratio", arguments.filter.noise_to_signal_ratio,
                 "least noise-to-signal ratio of the Wiener filter")
      .show_default();
  app.add_flag(
      "--fixed-regularization", [&] { arguments.filter.regularization = Regularization::FIXED; },
      "use the ratio as given for every block, whatever its noise");
  app.add_option("--engine", arguments.engine, "engine: auto, cpu, fourier, float, opencl, opencl:INDEX, opencl:NAME")
      .show_default();
  app.add_option("--threads", arguments.threads, "most threads of the engine; 0: one for each core").show_default();
  app.add_option("--block-size", arguments.blur_field.block_size_px, "side of a block [px], even").show_default();
  app.add_option("--max-extent-px", arguments.blur_field.max_extent_px, "blocks with a longer blur stay unchanged [px]")
      .show_default();
  app.add_option("--significant-bits", arguments.significant_bits,
                 "of a 16-bit image, 8 to 16; 0: the fewest of 10, 12, 14, 16 that hold all its pixels")
      .show_default();
  app.add_flag(
      "--no-validation", [&] { arguments.validation.rule = ValidationRule::NONE; },
      "deblur blocks even if the image contradicts the given blur");
  app.add_option("--mask", arguments.mask,
                 "PNG or PGM as large as the image: pixels of 0 do not show the scene and stay unchanged");
  app.add_option("--overlay", arguments.overlay, "also write a picture of the blur field");
  add_common_options(app, &arguments.common);
  app.check([&] {
    if (angle.given() != extent.given()) throw UsageError("--angle-deg and --extent-px need each other");
    if (angle.given() == field.given())
      throw UsageError("either --angle-deg and --extent-px or --field has to be given");
    if (field_offset.given() && !field.given()) throw UsageError("--field-offset needs --field");
  });
  return run_tool(app, argc, argv, [&arguments] { run(arguments); });
}

}  // namespace
}  // namespace gyro_deblur

int main(int argc, char** argv) { return gyro_deblur::main_of(argc, argv); }
