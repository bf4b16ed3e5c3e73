// Runs the self-calibration on a thread of its own.
#include "ros/self_calibrator.hpp"

#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <exception>
#include <iterator>
#include <string>
#include <utility>

#include "ros/image_conversion.hpp"

namespace gyro_deblur {
namespace {

/// Rates of 30 images a second are enough.
constexpr TimeNs kShortestStepNs = 30'000'000;
/// More than one that waits, and the work is behind: the next image takes its place.
constexpr std::size_t kMostWaiting = 2;
/// A minute of samples of a fast gyroscope.
constexpr std::size_t kMostSamples = 100'000;

/// Linux has a nice value for each thread.
void lower_priority() {
  constexpr int kNice = 10;
  setpriority(PRIO_PROCESS, static_cast<id_t>(syscall(SYS_gettid)), kNice);
}

}  // namespace

SelfCalibrator::SelfCalibrator(Work work, InputProblems* problems) : work_(work), problems_(*problems) {
  learned_ = calibration_.learned();
}

SelfCalibrator::~SelfCalibrator() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    stops_ = true;
  }
  wakes_.notify_all();
  if (thread_.joinable()) thread_.join();
}

void SelfCalibrator::set_expected_offset(TimeNs offset_ns) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (offset_ns == expected_offset_ns_) return;
  expected_offset_ns_ = offset_ns;
  forget(Job::Kind::CLEAR);
}

void SelfCalibrator::restart() {
  const std::lock_guard<std::mutex> lock(mutex_);
  forget(Job::Kind::RESTART);
}

void SelfCalibrator::clear() {
  const std::lock_guard<std::mutex> lock(mutex_);
  forget(Job::Kind::CLEAR);
}

void SelfCalibrator::forget(Job::Kind kind) {
  // A clearance that waits has not lost its effect.
  const bool clears = kind == Job::Kind::CLEAR || (!jobs_.empty() && jobs_.front().kind == Job::Kind::CLEAR);
  jobs_.clear();
  if (kind == Job::Kind::CLEAR) {
    learned_ = SelfCalibration().learned();
    ++updates_;
    ++clears_;
  }
  jobs_.push_back({clears ? Job::Kind::CLEAR : kind, clears_, expected_offset_ns_, {}, {}});
  samples_.clear();
  newest_ns_.reset();
}

void SelfCalibrator::add(std::vector<GyroSample> samples, Image image) {
  std::unique_lock<std::mutex> lock(mutex_);
  samples_.insert(samples_.end(), samples.begin(), samples.end());
  if (samples_.size() > kMostSamples) {
    samples_.erase(samples_.begin(), samples_.end() - static_cast<std::ptrdiff_t>(kMostSamples));
  }
  const TimeNs t_ns = image.exposure.start(0);
  if (newest_ns_ && t_ns >= *newest_ns_ && t_ns - *newest_ns_ < kShortestStepNs) return;
  newest_ns_ = t_ns;
  if (jobs_.size() >= kMostWaiting && jobs_.back().kind == Job::Kind::IMAGE) {
    std::vector<GyroSample>& before = jobs_.back().samples;
    before.insert(before.end(), samples_.begin(), samples_.end());
    jobs_.back().image = std::move(image);
  } else {
    jobs_.push_back({Job::Kind::IMAGE, clears_, 0, std::move(samples_), std::move(image)});
  }
  samples_.clear();
  if (work_ == Work::AT_ONCE) {
    while (!jobs_.empty()) run_first(&lock);
    return;
  }
  if (!thread_.joinable()) thread_ = std::thread(&SelfCalibrator::work, this);
  wakes_.notify_one();
}

void SelfCalibrator::work() {
  lower_priority();
  std::unique_lock<std::mutex> lock(mutex_);
  while (true) {
    wakes_.wait(lock, [this] { return stops_ || !jobs_.empty(); });
    if (stops_) return;
    run_first(&lock);
  }
}

void SelfCalibrator::run_first(std::unique_lock<std::mutex>* lock) {
  const Job job = std::move(jobs_.front());
  jobs_.pop_front();
  lock->unlock();
  run(job);
  lock->lock();
}

void SelfCalibrator::run(const Job& job) {
  try {
    if (job.kind == Job::Kind::CLEAR) calibration_ = SelfCalibration(job.expected_offset_ns);
    if (job.kind != Job::Kind::IMAGE) {
      calibration_.restart();
      tracker_.reset();
      return;
    }
    for (const GyroSample& sample : job.samples) calibration_.add_sample(sample);
    look_at(*job.image);
    if (!calibration_.is_due()) return;
    calibration_.update();
  } catch (const std::exception& error) {
    problems_.log(LogLevel::ERROR, "self-calibration",
                  std::string("self-calibration left an image out: ") + error.what());
    return;
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  if (job.clears != clears_) return;  // forgotten meanwhile
  learned_ = calibration_.learned();
  ++updates_;
}

void SelfCalibrator::look_at(const Image& image) {
  const ImageView view = view_image(*image.image);
  const cv::Mat luminance = luminance8(view.image, view.layout, bit_depth_.of(view.image, view.layout));
  tracker_.set_mask(image.mask);
  const std::optional<ImageRate> rate =
      tracker_.add(luminance, Camera(image.calibration), image.exposure, image.lens_known);
  if (rate) calibration_.add_rate(*rate);
}

LearnedCalibration SelfCalibrator::learned() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return learned_;
}

std::size_t SelfCalibrator::updates() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return updates_;
}

}  // namespace gyro_deblur
