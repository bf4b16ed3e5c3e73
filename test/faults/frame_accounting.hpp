// Counts what goes into the processor and what comes out, and finds what must not happen.
#pragma once

#include <cstddef>
#include <map>
#include <set>
#include <vector>

#include <sensor_msgs/Image.h>

#include "ros/processor.hpp"
#include "sync/pass_through.hpp"

namespace gyro_deblur::test {

/// The balance of one run.
struct Balance {
  std::size_t frames_in = 0;
  std::size_t frames_out = 0;
  std::size_t deblurred = 0;  ///< at least one block was deconvolved
  std::size_t unchanged = 0;  ///< processed, no block was
  std::map<PassThroughReason, std::size_t> passed_through;

  // What must be 0.
  std::size_t lost = 0;        ///< did not come out
  std::size_t repeated = 0;    ///< came out again, or was never given
  std::size_t reordered = 0;   ///< came out when it was not the next
  std::size_t misstamped = 0;  ///< one of its outputs has another stamp
  std::size_t altered = 0;     ///< a pixel changed that is in no deblurred block, or the input message did
  std::size_t retained = 0;    ///< still held when everything had come out

  bool good() const { return lost + repeated + reordered + misstamped + altered + retained == 0; }
  /// Adds another run's counts.
  Balance& operator+=(const Balance& other);
};

/// Knows every image by its message. Not thread-safe.
class FrameAccounting {
 public:
  void in(const sensor_msgs::ImageConstPtr& image);
  void out(const FrameOutput& output);

  /// Balance when everything should have come out. The messages given to in() must be held by nobody but the
  /// accounting then; images that others hold too count as retained.
  Balance balance() const;

 private:
  struct Entry {
    sensor_msgs::ImageConstPtr image;
    std::size_t hash = 0;
    bool out = false;
  };
  std::vector<Entry> entries_;
  std::map<const sensor_msgs::Image*, std::vector<std::size_t>> indices_;  // a message may be given twice
  std::size_t next_ = 0;                                                   // the one that has to come out
  Balance balance_;
};

}  // namespace gyro_deblur::test
