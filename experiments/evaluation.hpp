// How good features are when the homography between two images is known: repeatability and localisation error as in the
// paper (section V-A, after Mikolajczyk et al., IJCV 2005), matching, and the homography that matches give back.
#pragma once

#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "gyro_deblur/keypoints.hpp"

namespace gyro_deblur::experiments {

/// Takes a pixel of image 1 to image 2 or the like: H_2_1 takes image 1 to image 2. Pixel centres at integers.
using Homography = cv::Matx33d;

/// Reads three rows of three numbers, as the Oxford sets' H1to2p. Throws std::runtime_error with the path when the file
/// does not hold them or they are singular.
Homography read_homography(const std::string& path);

/// H * (x, y, 1), divided. Points on the horizon of H give infinite or NaN coordinates.
cv::Point2d project(const Homography& H, const cv::Point2d& point_px);

/// By how much H magnifies lengths at a point: the square root of the Jacobian's |determinant|, |det H| / |w|^3.
double local_scale(const Homography& H, const cv::Point2d& point_px);

/// Intersection over union of two discs, in [0, 1]. Preconditions: radii > 0, distance >= 0.
double disc_overlap(double radius1_px, double radius2_px, double distance_px);

/// Keypoints of the same place and scale count once (detectors repeat those with several orientations); the first one
/// stays, in order.
std::vector<cv::KeyPoint> without_duplicates(const std::vector<cv::KeyPoint>& keypoints);

/// The `count` strongest of those keypoints (by response, ties in order) whose centres H_other_own takes into the other
/// image, by falling response.
std::vector<cv::KeyPoint> strongest_in_common_region(const std::vector<cv::KeyPoint>& keypoints,
                                                     const Homography& H_other_own, const cv::Size& other_size,
                                                     int count);

/// How keypoints become the discs that are compared.
struct OverlapOptions {
  /// (0, 1]: 0.6 is the paper's 40 % overlap error
  double min_overlap = 0.6;
  /// (0, 100]: radius over cv::KeyPoint::size. OpenCV's SIFT reports 2 sigma, so that 1.5 gives discs of 3 sigma.
  double radius_factor = 1.5;
  /// [0, 1000] px: the disc of image 1 is magnified to this radius and the other one with it before they are compared
  /// (30 px in Mikolajczyk et al.), which takes the advantage from large discs. 0: discs as they are.
  double normalized_radius_px = 0;

  void validate() const;  ///< throws OptionError
};

/// One keypoint of each image that show the same place.
struct Correspondence {
  int index1 = 0, index2 = 0;
  double overlap = 0;   ///< intersection over union
  double error_px = 0;  ///< distance of the centres in image 1
};

/// Pairs with at least min_overlap, one to one: the pair of largest overlap first. Image 2's discs are taken to image
/// 1, centres by the homography's inverse and radii by its local scale there.
std::vector<Correspondence> find_correspondences(const std::vector<cv::KeyPoint>& keypoints1,
                                                 const std::vector<cv::KeyPoint>& keypoints2, const Homography& H_2_1,
                                                 const OverlapOptions& options);

/// Repeatability of a detector on a pair of images.
struct Repeatability {
  int keypoints1 = 0, keypoints2 = 0;  ///< that were compared; fewer than asked for when there are no more
  int correspondences = 0;
  double ratio = 0;     ///< correspondences / min(keypoints1, keypoints2); 0 without keypoints
  double error_px = 0;  ///< mean localisation error of the correspondences, in image 1; NaN without any
};

/// Compares the `count` strongest keypoints of the part that both images show. Duplicates must have been removed.
Repeatability evaluate_repeatability(const std::vector<cv::KeyPoint>& keypoints1, const cv::Size& size1,
                                     const std::vector<cv::KeyPoint>& keypoints2, const cv::Size& size2,
                                     const Homography& H_2_1, int count, const OverlapOptions& options);

struct MatchingOptions {
  int max_keypoints = 1000;        ///< [1, 100000]; strongest by response, of each image
  double max_ratio = 0.8;          ///< (0, 1]: nearest over second nearest descriptor distance (Lowe 2004)
  double max_error_px = 5;         ///< (0, 1000]: in image 2, for a match to be correct
  double ransac_px = 3;            ///< (0, 100]: reprojection error of RANSAC's inliers
  double max_corner_error_px = 5;  ///< (0, 1000]: of a homography that counts as found

  void validate() const;  ///< throws OptionError
};

/// What the descriptors of two images are worth.
struct Matching {
  int matches = 0;                ///< that passed the ratio test
  int correct = 0;                ///< of those, within max_error_px of the truth
  bool homography_found = false;  ///< the homography estimated from the matches is right: corner_error_px is small
  double corner_error_px = 0;     ///< mean distance of image 1's corners from where the true homography takes them;
                                  ///< infinite when there was nothing to estimate from
};

/// Nearest neighbours of image 1's descriptors among image 2's (Hamming distance for CV_8U, else Euclidean), ratio
/// test, comparison with the truth, and a homography by RANSAC. Features hold at least max_keypoints where there are so
/// many, by falling response.
Matching evaluate_matching(const Features& features1, const cv::Size& size1, const Features& features2,
                           const Homography& H_2_1, const MatchingOptions& options);

/// OpenCV's SIFT (DoG) keypoints by falling response, each place and scale once. Thresholds: contrast 0, so that the
/// number of detections can be fixed by response; edges 10 (Lowe 2004). Image: CV_8UC1.
std::vector<cv::KeyPoint> detect_dog(const cv::Mat& image);

/// The `count` strongest of detect_dog() with their SIFT descriptors.
Features extract_sift(const cv::Mat& image, int count);

/// The `count` strongest ORB features, FAST threshold 5, with their descriptors.
Features extract_orb(const cv::Mat& image, int count);

}  // namespace gyro_deblur::experiments
