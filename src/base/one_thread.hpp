// What OpenCV does on threads of its own, done on those that call it: the caller's, and those of a parallel_for()
// within.
#pragma once

#include <opencv2/core.hpp>

namespace gyro_deblur {

/// Runs `work` with OpenCV's parallel loops in it on this thread, whatever cv::setNumThreads() says: OpenCV runs a loop
/// within a loop serially. For work that is too small for threads: under contention they wait for each other.
/// OpenCV knows of one outer loop in a process: those of other threads are serial meanwhile, and where another thread
/// is in one already, this `work` may get threads when that ends.
template <typename Work>
void on_one_thread(Work&& work) {
  cv::parallel_for_(cv::Range(0, 1), [&work](const cv::Range&) { work(); });
}

}  // namespace gyro_deblur
