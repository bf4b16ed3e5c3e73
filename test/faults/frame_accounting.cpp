#include "frame_accounting.hpp"

#include <cstring>
#include <functional>
#include <string_view>

#include "gyro_deblur/frame_blur.hpp"

namespace gyro_deblur::test {
namespace {

std::size_t hash_of(const sensor_msgs::Image& image) {
  const std::string_view pixels(reinterpret_cast<const char*>(image.data.data()), image.data.size());
  return std::hash<std::string_view>()(pixels) ^ std::hash<std::string>()(image.encoding) ^ image.width ^
         (static_cast<std::size_t>(image.height) << 32) ^ (static_cast<std::size_t>(image.step) << 16);
}

bool identical(const sensor_msgs::Image& a, const sensor_msgs::Image& b) {
  return a.header.stamp == b.header.stamp && a.header.frame_id == b.header.frame_id && a.width == b.width &&
         a.height == b.height && a.encoding == b.encoding && a.step == b.step && a.is_bigendian == b.is_bigendian &&
         a.data == b.data;
}

/// The pixels of all blocks that were not deconvolved are those of the input.
bool identical_outside_deblurred(const sensor_msgs::Image& input, const sensor_msgs::Image& output,
                                 const FrameBlur& field) {
  if (output.width != input.width || output.height != input.height || output.encoding != input.encoding) return false;
  const std::size_t pixel_bytes = output.step / output.width;
  for (int i = 0; i < field.grid.size(); ++i) {
    if (field.blocks[static_cast<std::size_t>(i)].status == BlockStatus::DEBLURRED) continue;
    const cv::Rect rect = field.grid.rect(i);
    for (int y = rect.y; y < rect.br().y; ++y) {
      const auto row = static_cast<std::size_t>(y), column = static_cast<std::size_t>(rect.x) * pixel_bytes;
      if (std::memcmp(input.data.data() + row * input.step + column, output.data.data() + row * output.step + column,
                      static_cast<std::size_t>(rect.width) * pixel_bytes) != 0) {
        return false;
      }
    }
  }
  return true;
}

}  // namespace

Balance& Balance::operator+=(const Balance& other) {
  frames_in += other.frames_in;
  frames_out += other.frames_out;
  deblurred += other.deblurred;
  unchanged += other.unchanged;
  for (const auto& [reason, count] : other.passed_through) passed_through[reason] += count;
  lost += other.lost;
  repeated += other.repeated;
  reordered += other.reordered;
  misstamped += other.misstamped;
  altered += other.altered;
  retained += other.retained;
  return *this;
}

void FrameAccounting::in(const sensor_msgs::ImageConstPtr& image) {
  ++balance_.frames_in;
  indices_[image.get()].push_back(entries_.size());
  entries_.push_back({image, hash_of(*image), false});
}

void FrameAccounting::out(const FrameOutput& output) {
  ++balance_.frames_out;
  std::size_t index = entries_.size();
  const auto found = indices_.find(output.input.get());
  if (found != indices_.end()) {
    for (const std::size_t candidate : found->second) {
      if (!entries_[candidate].out && index == entries_.size()) index = candidate;
    }
  }
  if (index == entries_.size()) {
    ++balance_.repeated;
    return;
  }
  entries_[index].out = true;
  if (index != next_) ++balance_.reordered;
  next_ = index + 1;
  if (output.dropped) return;  // nothing of it leaves

  const ros::Time stamp = output.input->header.stamp;
  if (output.image->header.stamp != stamp || output.camera_info->header.stamp != stamp ||
      output.blur_field->header.stamp != stamp || (output.keypoints && output.keypoints->header.stamp != stamp)) {
    ++balance_.misstamped;
  }
  bool altered = hash_of(*output.input) != entries_[index].hash;
  const bool any_deblurred = output.field && output.field->count(BlockStatus::DEBLURRED) > 0;
  if (output.reason != PassThroughReason::NONE || !any_deblurred) {
    altered = altered || !identical(*output.input, *output.image);
  } else {
    altered = altered || !identical_outside_deblurred(*output.input, *output.image, *output.field);
  }
  if (altered) ++balance_.altered;
  if (output.reason != PassThroughReason::NONE) {
    ++balance_.passed_through[output.reason];
  } else if (any_deblurred) {
    ++balance_.deblurred;
  } else {
    ++balance_.unchanged;
  }
}

Balance FrameAccounting::balance() const {
  Balance balance = balance_;
  for (const auto& [message, indices] : indices_) {
    const Entry& entry = entries_[indices.front()];
    if (entry.image.use_count() != static_cast<long>(indices.size())) ++balance.retained;
  }
  for (const Entry& entry : entries_) balance.lost += entry.out ? 0 : 1;
  return balance;
}

}  // namespace gyro_deblur::test
