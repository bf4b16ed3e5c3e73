// The paper's figure on deconvolution (section IV-A): the Wiener filter in space against the frequency domain, with the
// ringing at the image's borders measured, and the kernels; and what the regularizations restore at other extents.

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "baselines.hpp"
#include "image_pairs.hpp"
#include "inverse/filter_bank.hpp"
#include "inverse/line_taps.hpp"
#include "pipeline/deconvolution.hpp"
#include "synthetic_blur.hpp"
#include "tools/output_file.hpp"
#include "tools/progress.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur::experiments {
namespace {

constexpr LineBlur kBlur = {20 * CV_PI / 180, 31};  // the paper's
constexpr double kBandExtents = 1.5;                // width of the border in extents
// The blurred image is cut out of a larger one, so that its border holds real light from outside.
constexpr int kMarginPx = 32;

struct Arguments {
  std::string out = "results";
  std::string data = GYRO_DEBLUR_DATA_DIR;
  std::string picture;
  double noise_grey_levels = 1;
  std::uint64_t seed = 1;
  bool quick = false, quiet = false;
};

struct Method {
  const char* name;
  cv::Mat (*restore)(const cv::Mat& blurred);
};

cv::Mat frequency(const cv::Mat& blurred, bool taper) {
  cv::Mat out;
  deblur_in_frequency(blurred, kBlur, FilterOptions().noise_to_signal_ratio, taper).convertTo(out, CV_8U);
  return out;
}

const Method kMethods[] = {
    {"blurred", [](const cv::Mat& blurred) { return blurred; }},
    {"frequency", [](const cv::Mat& blurred) { return frequency(blurred, false); }},
    {"frequency_tapered", [](const cv::Mat& blurred) { return frequency(blurred, true); }},
    {"spatial", [](const cv::Mat& blurred) { return deblur_in_space(blurred, kBlur); }},
};

/// Root mean square error [grey levels] nearer to the border than the band's width, and farther.
struct Errors {
  double border = 0, interior = 0;
};

Errors errors_of(const cv::Mat& image, const cv::Mat& truth) {
  const int band = static_cast<int>(std::lround(kBandExtents * kBlur.extent_px));
  const cv::Rect inside(band, band, image.cols - 2 * band, image.rows - 2 * band);
  const double all = std::pow(cv::norm(image, truth, cv::NORM_L2), 2);
  const double within = std::pow(cv::norm(image(inside), truth(inside), cv::NORM_L2), 2);
  return {std::sqrt((all - within) / (image.total() - inside.area())), std::sqrt(within / inside.area())};
}

void write_image(const std::string& path, const cv::Mat& image) {
  if (!cv::imwrite(path, image)) throw std::runtime_error(path + ": cannot be written");
}

/// The kernel as the paper draws it, along the line and in the plane. Returns how much of the plane is not zero.
nlohmann::json write_kernels(const std::string& folder) {
  const LineKernel kernel = wiener_kernel(kBlur.extent_px, FilterOptions());
  std::ofstream line(folder + "/deconvolution_kernel_1d.csv");
  line << "position_px,weight\n";
  for (std::size_t i = 0; i < kernel.taps.size(); ++i) {
    line << static_cast<int>(i) - kernel.radius() << ',' << kernel.taps[i] << '\n';
  }
  const std::vector<KernelTap> taps = rotate_kernel(kernel, kBlur.angle_rad);
  int rx = 0, ry = 0;
  for (const KernelTap& tap : taps) {
    rx = std::max(rx, std::abs(tap.dx));
    ry = std::max(ry, std::abs(tap.dy));
  }
  std::ofstream plane(folder + "/deconvolution_kernel_2d.csv");
  plane << "dx_px,dy_px,weight\n";
  for (const KernelTap& tap : taps) plane << tap.dx << ',' << tap.dy << ',' << tap.weight << '\n';
  if (!line.flush() || !plane.flush()) throw std::runtime_error(folder + ": the kernels cannot be written");
  return {{"taps", taps.size()}, {"width_px", 2 * rx + 1}, {"height_px", 2 * ry + 1}};
}

const std::pair<const char*, Regularization> kRules[] = {
    {"paper", Regularization::PAPER}, {"fixed", Regularization::FIXED}, {"adaptive", Regularization::ADAPTIVE}};

double psnr_of(const cv::Mat& image, const cv::Mat& truth) {
  const double squares = std::pow(cv::norm(image, truth, cv::NORM_L2), 2);
  return 10 * std::log10(255.0 * 255.0 * static_cast<double>(truth.total()) / squares);
}

/// What each rule gains over the blurred image in PSNR [dB], whole images with their borders, mean and least of images
/// and two angles; a record for each noise, rule and extent.
nlohmann::json compare_rules(const Arguments& arguments, std::vector<ImagePair> pairs) {
  const std::vector<double> extents_px =
      arguments.quick ? std::vector<double>{3, 20} : std::vector<double>{2, 2.25, 3, 5, 10, 20, 40, 60, 90, 120};
  const std::vector<double> angles_deg = {20, 100}, noises = {1, 2, 4, 8};
  if (arguments.quick) pairs.resize(1);
  nlohmann::json records = nlohmann::json::array();
  Progress progress(extents_px.size(), "extents", arguments.quiet);
  for (std::size_t e = 0; e < extents_px.size(); ++e) {
    // By noise and rule.
    std::vector<double> gains_db(noises.size() * std::size(kRules));
    std::vector<double> least_db(gains_db.size(), std::numeric_limits<double>::infinity());
    for (std::size_t p = 0; p < pairs.size(); ++p) {
      const cv::Mat& photograph = pairs[p].image1;
      const cv::Rect inner(kMarginPx, kMarginPx, photograph.cols - 2 * kMarginPx, photograph.rows - 2 * kMarginPx);
      const cv::Mat sharp = photograph(inner).clone();
      for (const double angle_deg : angles_deg) {
        const LineBlur blur = {angle_deg * CV_PI / 180, extents_px[e]};
        const cv::Mat exposed = test::blur_along_line(photograph, blur.angle_rad, blur.extent_px)(inner);
        for (std::size_t n = 0; n < noises.size(); ++n) {
          const cv::Mat blurred = test::expose(exposed, noises[n], arguments.seed * 1000 + p);
          for (std::size_t r = 0; r < std::size(kRules); ++r) {
            FilterOptions options;
            options.regularization = kRules[r].second;
            const double gain_db = psnr_of(deblur_in_space(blurred, blur, options), sharp) - psnr_of(blurred, sharp);
            const std::size_t i = n * std::size(kRules) + r;
            gains_db[i] += gain_db / static_cast<double>(pairs.size() * angles_deg.size());
            least_db[i] = std::min(least_db[i], gain_db);
          }
        }
      }
    }
    for (std::size_t i = 0; i < gains_db.size(); ++i) {
      records.push_back({{"noise_grey_levels", noises[i / std::size(kRules)]},
                         {"rule", kRules[i % std::size(kRules)].first},
                         {"extent_px", extents_px[e]},
                         {"gain_db", gains_db[i]},
                         {"least_db", least_db[i]}});
    }
    progress.done(e + 1);
  }
  return records;
}

void run(const Arguments& arguments) {
  std::string source;
  std::vector<ImagePair> pairs = load_pairs(arguments.data, source);
  if (arguments.quick) pairs.resize(3);
  const std::string picture = arguments.picture.empty() ? pairs[1].name : arguments.picture;
  const auto is_picture = [&](const ImagePair& pair) { return pair.name == picture; };
  std::filesystem::create_directories(arguments.out);
  if (std::none_of(pairs.begin(), pairs.end(), is_picture)) {
    throw std::runtime_error("picture \"" + picture + "\" is none of the " + source);
  }

  std::ofstream csv(arguments.out + "/deconvolution.csv");
  csv << "image,method,rmse_border,rmse_interior\n";
  std::vector<Errors> squares(std::size(kMethods));
  Progress progress(pairs.size(), "images", arguments.quiet);
  for (std::size_t p = 0; p < pairs.size(); ++p) {
    const cv::Mat& photograph = pairs[p].image1;
    const cv::Rect inner(kMarginPx, kMarginPx, photograph.cols - 2 * kMarginPx, photograph.rows - 2 * kMarginPx);
    const cv::Mat sharp = photograph(inner).clone();
    const cv::Mat blurred = test::expose(test::blur_along_line(photograph, kBlur.angle_rad, kBlur.extent_px)(inner),
                                         arguments.noise_grey_levels, arguments.seed * 1000 + p);
    for (std::size_t m = 0; m < std::size(kMethods); ++m) {
      const cv::Mat restored = kMethods[m].restore(blurred);
      const Errors errors = errors_of(restored, sharp);
      squares[m].border += errors.border * errors.border / pairs.size();
      squares[m].interior += errors.interior * errors.interior / pairs.size();
      csv << pairs[p].name << ',' << kMethods[m].name << ',' << errors.border << ',' << errors.interior << '\n';
      if (is_picture(pairs[p])) {
        write_image(arguments.out + "/deconvolution_" + kMethods[m].name + ".png", restored);
      }
    }
    progress.done(p + 1);
  }
  nlohmann::json methods = nlohmann::json::array();
  for (std::size_t m = 0; m < std::size(kMethods); ++m) {
    methods.push_back({{"method", kMethods[m].name},
                       {"rmse_border", std::sqrt(squares[m].border)},
                       {"rmse_interior", std::sqrt(squares[m].interior)}});
  }
  if (!csv.flush()) throw std::runtime_error(arguments.out + ": the results cannot be written");
  write_json(arguments.out + "/deconvolution.json", {{"images", source},
                                                     {"count", pairs.size()},
                                                     {"picture", picture},
                                                     {"angle_deg", kBlur.angle_rad * 180 / CV_PI},
                                                     {"extent_px", kBlur.extent_px},
                                                     {"band_px", std::lround(kBandExtents * kBlur.extent_px)},
                                                     {"noise_to_signal_ratio", FilterOptions().noise_to_signal_ratio},
                                                     {"noise_grey_levels", arguments.noise_grey_levels},
                                                     {"kernel", write_kernels(arguments.out)},
                                                     {"methods", methods},
                                                     {"rules", compare_rules(arguments, pairs)}});
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CommandLine app("Wiener deconvolution in space against the frequency domain: writes deconvolution*.csv, .json, .png",
                  "deconvolution_figure");
  app.add_option("--out", arguments.out, "folder for the results").show_default();
  app.add_option("--data", arguments.data, "folder with oxford_affine; without it, photographs of opencv-doc")
      .show_default();
  app.add_option("--picture", arguments.picture, "name of the image that is written; default: the second");
  app.add_option("--noise", arguments.noise_grey_levels, "standard deviation [grey levels]")
      .range(0, 100)
      .show_default();
  app.add_option("--seed", arguments.seed, "of the noise").show_default();
  app.add_flag("--quick", arguments.quick, "three images");
  app.add_flag("--quiet", arguments.quiet, "no progress");
  return run_tool(app, argc, argv, [&arguments] { run(arguments); });
}

}  // namespace
}  // namespace gyro_deblur::experiments

int main(int argc, char** argv) { return gyro_deblur::experiments::main_of(argc, argv); }
