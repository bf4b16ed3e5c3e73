#include "image_pairs.hpp"

#include <cmath>
#include <filesystem>
#include <stdexcept>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

namespace gyro_deblur::experiments {
namespace {

cv::Mat read_gray(const std::string& path) {
  const cv::Mat image = cv::imread(path, cv::IMREAD_GRAYSCALE);
  if (image.empty()) throw std::runtime_error(path + ": not an image that can be read");
  return image;
}

/// Rotation by `angle_deg`, zoom and perspective about the centre of the image.
Homography about_center(const cv::Size& size, double angle_deg, double zoom, double perspective_x) {
  const double cx = (size.width - 1) / 2.0, cy = (size.height - 1) / 2.0, angle = angle_deg * CV_PI / 180;
  const double c = zoom * std::cos(angle), s = zoom * std::sin(angle);
  const Homography to_center(1, 0, -cx, 0, 1, -cy, 0, 0, 1), back(1, 0, cx, 0, 1, cy, 0, 0, 1);
  // Perspective in units of the half width.
  return back * Homography(c, -s, 0, s, c, 0, perspective_x / cx, 0, 1) * to_center;
}

}  // namespace

std::vector<ImagePair> oxford_pairs(const std::string& folder) {
  std::vector<ImagePair> pairs;
  if (!std::filesystem::is_directory(folder)) return pairs;
  for (const std::string name : {"bark", "bikes", "boat", "graf", "leuven", "trees", "ubc", "wall"}) {
    const std::string of_set = folder + "/" + name;
    pairs.push_back(
        {name, read_gray(of_set + "/img1.png"), read_gray(of_set + "/img2.png"), read_homography(of_set + "/H1to2p")});
  }
  return pairs;
}

std::vector<ImagePair> photograph_pairs(const std::string& folder) {
  struct View {
    const char* file;
    double angle_deg, zoom, perspective;
  };
  // Two of each: zoom and rotation, viewpoint, a camera that hardly moved, none.
  const View views[] = {{"data/aloeL.jpg", 30, 0.85, 0},       {"data/building.jpg", -15, 0.9, 0},
                        {"data/graf1.png", 10, 0.95, 0.12},    {"data/leuvenA.jpg", 0, 0.95, -0.1},
                        {"data/starry_night.jpg", 1, 1, 0.01}, {"data/ela_original.jpg", -2, 1, 0},
                        {"text/scenetext01.jpg", 0, 1, 0},     {"ximgproc/stanford.png", 0, 1, 0}};
  std::vector<ImagePair> pairs;
  for (const View& view : views) {
    const cv::Mat photograph = read_gray(folder + "/" + view.file);
    const Homography H = about_center(photograph.size(), view.angle_deg, view.zoom, view.perspective);
    cv::Mat second;
    cv::warpPerspective(photograph, second, H, photograph.size(), cv::INTER_CUBIC, cv::BORDER_REFLECT_101);
    pairs.push_back({std::filesystem::path(view.file).stem().string(), photograph, second, H});
  }
  return pairs;
}

std::vector<ImagePair> load_pairs(const std::string& data_dir, std::string& source) {
  std::vector<ImagePair> pairs = oxford_pairs(data_dir + "/oxford_affine");
  source = pairs.empty() ? "photographs of opencv-doc" : "Oxford affine sets";
  return pairs.empty() ? photograph_pairs() : pairs;
}

cv::Mat photo_wall(const cv::Size& size_px, int columns, int rows, const std::vector<ImagePair>& pairs,
                   std::size_t first) {
  cv::Mat wall(size_px, CV_8UC1);
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      const cv::Point begin(column * size_px.width / columns, row * size_px.height / rows);
      const cv::Point end((column + 1) * size_px.width / columns, (row + 1) * size_px.height / rows);
      cv::Mat tile = wall(cv::Rect(begin, end));
      cv::resize(pairs[first++ % pairs.size()].image1, tile, tile.size(), 0, 0, cv::INTER_AREA);
    }
  }
  return wall;
}

}  // namespace gyro_deblur::experiments
