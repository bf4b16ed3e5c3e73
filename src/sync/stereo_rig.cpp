// Decides what is done with the images of a pair, and which have to wait for another.
#include "sync/stereo_rig.hpp"

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <utility>

#include "base/format.hpp"

namespace gyro_deblur {
namespace {

/// More than frames may wait in a camera's queue (frame_queue_size).
constexpr std::size_t kPairsKept = 1100;

constexpr char kNothingToDeblur[] = "has no block of this image that may be deblurred";

std::mutex stereo_rigs_mutex;                                 // the next one
std::map<std::string, std::weak_ptr<StereoRig>> stereo_rigs;  // by the topic of the IMU

}  // namespace

void StereoRig::Punctuality::miss() { score_ = std::min(score_ + kMiss, kMost); }

void StereoRig::Punctuality::hit() { score_ = std::max(score_ - 1, 0); }

void StereoRig::Punctuality::came_late() { score_ = std::max(score_ - kMiss - 1, 0); }

std::shared_ptr<StereoRig> StereoRig::get(const std::string& imu_topic) {
  const std::lock_guard<std::mutex> lock(stereo_rigs_mutex);
  std::weak_ptr<StereoRig>& entry = stereo_rigs[imu_topic];
  std::shared_ptr<StereoRig> rig = entry.lock();
  if (!rig) entry = rig = std::make_shared<StereoRig>();
  return rig;
}

void StereoRig::wake_waiting(Id except) const {
  for (const auto& [id, member] : members_) {
    if (id != except && member.wait && member.wake) member.wake();
  }
}

void StereoRig::join(Id id, const std::string& name, TimeNs timeout_ns, const std::function<void()>& wake) {
  const std::lock_guard<std::mutex> lock(mutex_);
  Member& member = members_[id];
  member.name = name;
  member.timeout_ns = timeout_ns;
  member.wake = wake;
}

void StereoRig::leave(Id id) {
  const std::lock_guard<std::mutex> lock(mutex_);
  wake_waiting();
  members_.erase(id);
  for (const std::shared_ptr<Pair>& pair : pairs_) pair->places.erase(id);
}

void StereoRig::announce(Id id, TimeNs stamp_ns) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto member = members_.find(id);
  if (member == members_.end()) return;
  // The newest first: a recording that is played again has the same stamps.
  const auto found = std::find_if(pairs_.rbegin(), pairs_.rend(), [&](const std::shared_ptr<Pair>& pair) {
    return std::abs(pair->stamp_ns - stamp_ns) <= kTolerance && pair->places.count(id) == 0;
  });
  std::shared_ptr<Pair> pair;
  if (found != pairs_.rend()) {
    pair = *found;
    if (pair->agreed) member->second.sending.came_late();
  } else {
    pair = std::make_shared<Pair>();
    pair->number = ++pairs_made_;
    pair->stamp_ns = stamp_ns;
    pairs_.push_back(pair);
    if (pairs_.size() > kPairsKept) pairs_.pop_front();
  }
  pair->places[id] = {stamp_ns, Phase::RECEIVED, std::nullopt};
  member->second.newest = pair->number;
  wake_waiting();
}

std::shared_ptr<StereoRig::Pair> StereoRig::find(Id id, TimeNs stamp_ns) const {
  // Images are published in order, so that the first with this stamp that is not reported yet is meant.
  std::shared_ptr<Pair> reported;
  for (const std::shared_ptr<Pair>& pair : pairs_) {
    const auto place = pair->places.find(id);
    if (place == pair->places.end() || place->second.stamp_ns != stamp_ns) continue;
    if (place->second.phase != Phase::REPORTED) return pair;
    reported = pair;
  }
  return reported;
}

template <typename Change>
void StereoRig::change(Id id, TimeNs stamp_ns, Change change) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const std::shared_ptr<Pair> pair = find(id, stamp_ns);
  if (!pair) return;
  change(pair);
  wake_waiting();
}

void StereoRig::begin(Id id, TimeNs stamp_ns) {
  change(id, stamp_ns, [id](const std::shared_ptr<Pair>& pair) {
    Phase& phase = pair->places[id].phase;
    if (phase == Phase::RECEIVED) phase = Phase::PROCESSING;
  });
}

void StereoRig::pass_stereo_partners_through(const std::shared_ptr<Pair>& pair, Id id, const std::string& why) {
  pair->places[id].phase = Phase::REPORTED;
  if (!pair->agreed && pair->pass_through_text.empty()) pair->pass_through_text = members_[id].name + " " + why;
}

void StereoRig::pass_through(Id id, TimeNs stamp_ns, const std::string& why) {
  change(id, stamp_ns, [&](const std::shared_ptr<Pair>& pair) {
    pair->none_dropped = true;
    pass_stereo_partners_through(pair, id, why);
  });
}

StereoRig::Blocking StereoRig::blocking(const Pair& pair, Id id) const {
  for (const auto& [other, member] : members_) {
    if (other == id) continue;
    const auto place = pair.places.find(other);
    if (place != pair.places.end()) {
      if (place->second.phase == Phase::REPORTED) continue;
      return {other, true, !member.deciding.is_unreliable() || place->second.phase == Phase::PROCESSING};
    }
    const bool left_out = member.newest > pair.number;
    if (member.newest > 0 && !left_out && !member.sending.is_unreliable()) return {other, false, true};
  }
  return {};
}

void StereoRig::record_punctuality(const Pair& pair, Id id) {
  for (auto& [other, member] : members_) {
    if (other == id || member.newest == 0) continue;
    const auto place = pair.places.find(other);
    if (place != pair.places.end()) {
      member.sending.hit();
      if (place->second.phase == Phase::REPORTED) member.deciding.hit();
    } else if (member.sending.is_unreliable()) {
      member.sending.miss();  // not waited for, and not there
    }
  }
}

void StereoRig::agree(Pair* pair) const {
  pair->agreed = true;
  if (pair->none_dropped) return;
  for (const auto& [id, place] : pair->places) {
    if (!place.drop_reasons) continue;
    const std::string& why =
        pair->pass_through_text.empty() ? place.drop_reasons->if_deblurred : place.drop_reasons->if_passed_through;
    if (why.empty()) continue;
    const auto member = members_.find(id);  // it may have left the rig
    pair->drop_text = "the image of " + (member == members_.end() ? "a camera" : member->second.name) + " is " + why;
    return;
  }
}

std::string StereoRig::give_up(const std::shared_ptr<Pair>& pair, Id id, const Blocking& blocking, bool waited,
                               bool deblurs) {
  Member& other = members_[blocking.id];
  if (waited) (blocking.has_come ? other.deciding : other.sending).miss();
  const std::string stamp = seconds_text(pair->places[id].stamp_ns) + " s";
  const std::string within = waited ? " within " + std::to_string(members_[id].timeout_ns / 1'000'000) + " ms" : "";
  pair->none_dropped = true;
  if (deblurs) pass_stereo_partners_through(pair, id, "has not waited for this image any longer");
  return blocking.has_come ? other.name + " has not decided on its image of " + stamp + within
                           : other.name + " has not had an image of " + stamp + within;
}

void StereoRig::add_report(const std::shared_ptr<Pair>& pair, Id id, const ImageReport& report) {
  pair->places[id].drop_reasons = report.drop_reasons;
  if (report.pass_through_text.empty()) {
    pair->places[id].phase = Phase::REPORTED;
  } else {
    pass_stereo_partners_through(pair, id, report.pass_through_text);
  }
  if (report.drop_reasons && !report.drop_reasons->may_be_dropped) pair->none_dropped = true;
}

std::optional<FrameAction> StereoRig::decide(Id id, TimeNs stamp_ns, const ImageReport& report) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto member = members_.find(id);
  // An image before may have failed while it waited.
  const auto is_of_this = [&](const Wait& wait) {
    const auto place = wait.pair->places.find(id);
    return place != wait.pair->places.end() && place->second.stamp_ns == stamp_ns;
  };
  const bool waited = member != members_.end() && member->second.wait && is_of_this(*member->second.wait);
  // One that has left the rig has no pair.
  const std::shared_ptr<Pair> pair = waited ? member->second.wait->pair : find(id, stamp_ns);
  if (!pair) return FrameAction{"", report.drop_reasons ? report.drop_reasons->if_deblurred : ""};
  std::optional<Wait>& wait = member->second.wait;
  if (!waited) {
    add_report(pair, id, report);
    const auto timeout = std::chrono::nanoseconds(member->second.timeout_ns);
    wait = Wait{pair, std::chrono::steady_clock::now() + timeout, {}};
  }
  const std::optional<FrameAction> action = decide_reported(id, &*wait, report, waited);
  if (action) wait.reset();
  if (action || !waited) wake_waiting(id);
  return action;
}

std::optional<std::chrono::steady_clock::time_point> StereoRig::deadline(Id id) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto member = members_.find(id);
  if (member == members_.end() || !member->second.wait) return std::nullopt;
  return member->second.wait->deadline;
}

std::optional<FrameAction> StereoRig::decide_reported(Id id, Wait* wait, const ImageReport& report, bool waited) {
  const std::shared_ptr<Pair>& pair = wait->pair;
  const bool droppable = report.drop_reasons && report.drop_reasons->may_be_dropped;
  if (pair->agreed) return FrameAction{pair->pass_through_text, droppable ? pair->drop_text : ""};
  const bool may_be_dropped = droppable && !pair->none_dropped;
  if (!may_be_dropped && (!report.deblurs || !pair->pass_through_text.empty())) {
    if (report.deblurs || report.drop_reasons) record_punctuality(*pair, id);
    return FrameAction{pair->pass_through_text, ""};
  }
  const Blocking before = std::exchange(wait->blocking, blocking(*pair, id));
  const auto left_out = members_.find(before.id);
  if (before.id && !before.has_come && wait->blocking.id != before.id && pair->places.count(before.id) == 0 &&
      left_out != members_.end()) {
    left_out->second.sending.miss();  // waited for in vain
  }
  if (!wait->blocking.id) {
    record_punctuality(*pair, id);
    agree(pair.get());
    return FrameAction{pair->pass_through_text, report.drop_reasons ? pair->drop_text : ""};
  }
  const bool timed_out = waited && std::chrono::steady_clock::now() >= wait->deadline;
  if (!timed_out && wait->blocking.worth_waiting) return std::nullopt;
  return FrameAction{give_up(pair, id, wait->blocking, waited, report.deblurs), ""};
}

StereoCamera::StereoCamera(std::shared_ptr<StereoRig> rig, std::string name)
    : rig_(std::move(rig)), name_(std::move(name)) {}

StereoCamera::~StereoCamera() { rig_->leave(this); }

void StereoCamera::set_timeout(TimeNs timeout_ns) {
  timeout_ns > 0 ? rig_->join(this, name_, timeout_ns, wake_) : rig_->leave(this);
}

void StereoCamera::pass_through(TimeNs stamp_ns, PassThroughReason reason) {
  rig_->pass_through(this, stamp_ns, std::string("passes this image through: ") + to_string(reason));
}

std::optional<FrameAction> StereoCamera::decide(TimeNs stamp_ns, const FrameBlur& field,
                                                const std::optional<DropReasons>& drop_reasons) {
  const bool deblurs = field.count(BlockStatus::DEBLURRED) > 0;
  const bool is_sharp = field.count(BlockStatus::SHARP) + field.count(BlockStatus::MASKED) == field.blocks.size();
  const std::string text = deblurs || is_sharp ? "" : kNothingToDeblur;
  std::optional<FrameAction> action = rig_->decide(this, stamp_ns, {deblurs, text, drop_reasons});
  if (action && !deblurs) action->pass_through_text.clear();  // nothing would be deblurred anyway
  return action;
}

}  // namespace gyro_deblur
