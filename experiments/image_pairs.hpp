// Pairs of photographs with known homographies.
#pragma once

#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "evaluation.hpp"

namespace gyro_deblur::experiments {

struct ImagePair {
  std::string name;
  cv::Mat image1, image2;  ///< CV_8UC1
  Homography H_2_1;        ///< takes image 1 to image 2
};

/// The first pair of each of the eight Oxford affine sets (Mikolajczyk et al., IJCV 2005) in grey, from `folder` with a
/// folder for every set: img1.png, img2.png, H1to2p. Empty when `folder` does not exist; throws std::runtime_error with
/// the path when something in it is missing.
std::vector<ImagePair> oxford_pairs(const std::string& folder);

/// Eight photographs of Debian's opencv-doc (`folder`: its examples), and each again through a homography as modest as
/// the Oxford sets' first: zoom and rotation, change of viewpoint, a small shift, none. Throws std::runtime_error with
/// the path of one that cannot be read.
std::vector<ImagePair> photograph_pairs(const std::string& folder = "/usr/share/doc/opencv-doc/examples");

/// Oxford's where DATA_DIR/oxford_affine exists, else photograph_pairs(); `source` says which, for the record.
std::vector<ImagePair> load_pairs(const std::string& data_dir, std::string& source);

/// The first images of pairs side by side, in turn from number `first` on, row by row, each stretched over its share.
/// Preconditions: a pair at least; as many pixels as columns, and as rows.
cv::Mat photo_wall(const cv::Size& size_px, int columns, int rows, const std::vector<ImagePair>& pairs,
                   std::size_t first);

}  // namespace gyro_deblur::experiments
