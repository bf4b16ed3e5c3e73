// Chooses between given and estimated exposure times.
#include "pipeline/exposure_choice.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <iterator>

namespace gyro_deblur {
namespace {

/// Stands for a ratio of 1 in a filter of exposures.
constexpr TimeNs kRatioNs = 10'000'000;

/// Assumptions for images whose exposure is not known. Estimates reach from kMinExposureRatio to kMaxExposureRatio of
/// an assumption, so that the two cover 3 to 81 ms. Shorter exposures blur little.
constexpr std::array<TimeNs, 2> kAssumedNs{10'000'000, 27'000'000};
/// Images in a row without an estimate before the next assumption is tried.
constexpr int kTries = 2;

/// Largest standard deviation of an exposure's logarithm with which images are deblurred by it.
constexpr double kSureEnough = 0.05;
/// The same for the images to contradict a given exposure.
constexpr double kSureToContradict = 0.03;

/// Logarithms of ratios of true to given exposure: a contradiction begins beyond the first, and ends within the second.
const double kContradicts = std::log(kContradictingRatio), kAgrees = std::log(1.04);
/// For so long, and by so many estimates. An auto exposure that hunts is back before.
constexpr TimeNs kContradictsForNs = 2'000'000'000;
constexpr int kContradictingEstimates = 5;

/// What a known exposure may still grow by from image to image.
constexpr double kMargin = 1.1;

TimeNs scaled(TimeNs time_ns, double factor) { return std::llround(static_cast<double>(time_ns) * factor); }

bool is_per_image(const GivenExposure& given) { return given.origin == ExposureOrigin::MESSAGE; }

/// Whether an estimate from the other exposure is well inside of what is searched.
bool is_within_reach(TimeNs exposure_ns, TimeNs assumed_ns) {
  constexpr double kReach = 2;
  const double ratio = static_cast<double>(exposure_ns) / static_cast<double>(assumed_ns);
  return ratio > 1 / kReach && ratio < kReach;
}

bool is_same(const GivenExposure& a, const GivenExposure& b) {
  return a.origin == b.origin && (is_per_image(a) || a.exposure_ns == b.exposure_ns);
}

}  // namespace

ExposureNeed exposure_need(double contrast, const std::optional<double>& noise, const FrameBlur& field) {
  // One image with a median of so much gives one by day, see doc/reports/exposure.md.
  constexpr float kEnoughPx = 6;
  // By day the noise of a camera is a tenth of the contrast or less.
  constexpr double kTooNoisy = 0.2;
  const auto is_long = [](const BlockBlur& block) { return block.extent_px >= kEnoughPx; };
  const auto moving = std::count_if(field.blocks.begin(), field.blocks.end(), is_long);
  if (2 * static_cast<std::size_t>(moving) < field.blocks.size()) return ExposureNeed::MOTION;
  return noise && *noise > kTooNoisy * contrast ? ExposureNeed::LIGHT : ExposureNeed::TEXTURE;
}

const char* to_string(ExposureOrigin origin) {
  static constexpr const char* kNames[]{"exposure message", "driver's setting", "exposure_time", "images"};
  const auto i = static_cast<std::size_t>(origin);
  return i < std::size(kNames) ? kNames[i] : "not known";
}

void ExposureChoice::set_policy(OnExposureConflict policy) {
  if (policy != policy_) forget_conflict();
  policy_ = policy;
}

const ExposureFilter& ExposureChoice::filter_of(const std::optional<GivenExposure>& given) const {
  return given && is_per_image(*given) ? ratios_ : exposures_;
}

std::optional<TimeNs> ExposureChoice::estimate_instead(const GivenExposure& given) const {
  const std::optional<ExposureFilter::State> state = filter_of(given).state();
  if (!state) return std::nullopt;
  return is_per_image(given) ? scaled(given.exposure_ns, static_cast<double>(state->exposure_ns) / kRatioNs)
                             : state->exposure_ns;
}

bool ExposureChoice::replaces(const GivenExposure& given) const {
  return conflict_ && conflict_->replaced && is_same(conflict_->given, given);
}

ExposurePlan ExposureChoice::plan(const std::optional<GivenExposure>& given,
                                  const std::optional<TimeNs>& period_ns) const {
  ExposurePlan plan;
  plan.given = given;
  plan.period_ns = period_ns.value_or(0);
  plan.estimate = filter_of(given).wants_estimate();
  // By plan.given. Where nothing is known it is the default, which is replaced below.
  static_cast<ChosenExposure&>(plan) = chosen(plan);
  if (given && !replaces(*given)) {
    plan.longest_ns = given->exposure_ns;
    // A value that is wrong by a factor of 3 or more, of a wrong unit for example, shows from another assumption only.
    const std::size_t other = assumption_ % (kAssumedNs.size() + 1);
    const std::optional<TimeNs> images_ns = estimate_instead(*given);
    if (!plan.estimate || (images_ns ? is_within_reach(*images_ns, given->exposure_ns) : other == 0)) return plan;
    plan.exposure_ns = images_ns ? *images_ns : kAssumedNs[other - 1];
    plan.longest_ns = std::max(plan.longest_ns, plan.exposure_ns);
  } else if (exposures_.state()) {
    const bool is_sure = plan.origin == ExposureOrigin::IMAGES;
    plan.longest_ns = scaled(plan.exposure_ns, is_sure ? kMargin : std::exp(2 * plan.log_stddev));
  } else {
    plan.exposure_ns = kAssumedNs[assumption_ % kAssumedNs.size()];
    plan.longest_ns = scaled(plan.exposure_ns, kMaxExposureRatio);
  }
  constexpr TimeNs kLongestNs = 1'000'000'000;  // that an exposure may be
  plan.longest_ns = std::min(plan.longest_ns, kLongestNs);
  if (period_ns && !(given && plan.exposure_ns == given->exposure_ns)) {
    plan.exposure_ns = std::min(plan.exposure_ns, *period_ns);
    plan.longest_ns = std::max(plan.exposure_ns, std::min(plan.longest_ns, *period_ns));
  }
  return plan;
}

ChosenExposure ExposureChoice::chosen(const ExposurePlan& plan) const {
  if (plan.given && !replaces(*plan.given)) return {plan.given->origin, plan.given->exposure_ns, 0};
  if (const std::optional<ExposureFilter::State> state = exposures_.state()) {
    const bool is_sure = plan.given || state->log_stddev <= kSureEnough;
    return {is_sure ? ExposureOrigin::IMAGES : ExposureOrigin::ASSUMED, state->exposure_ns, state->log_stddev};
  }
  return {ExposureOrigin::ASSUMED, plan.exposure_ns, plan.log_stddev};
}

ChosenExposure ExposureChoice::decide(TimeNs stamp_ns, const ExposurePlan& plan,
                                      const std::optional<ExposureEstimate>& estimate, double mean_brightness) {
  if (plan.decided) return plan;
  const std::optional<GivenExposure>& given = plan.given;
  // An image that comes late changes nothing: a filter would begin anew. After a time jump there is a reset().
  if (newest_ns_ && stamp_ns < *newest_ns_) return chosen(plan);
  newest_ns_ = stamp_ns;
  if (given && is_per_image(*given)) {
    const double assumed = static_cast<double>(plan.exposure_ns) / static_cast<double>(given->exposure_ns);
    ratios_.add(stamp_ns, std::max<TimeNs>(scaled(kRatioNs, assumed), 1), estimate, mean_brightness);
  } else {
    exposures_.add(stamp_ns, plan.exposure_ns, estimate, mean_brightness);
  }
  if (estimate) in_vain_ = 0;
  if (plan.estimate && !estimate && ++in_vain_ % kTries == 0) ++assumption_;
  if (given) {
    compare(stamp_ns, *given, estimate.has_value());
  } else {
    forget_conflict();
  }
  return chosen(plan);
}

void ExposureChoice::forget_conflict() {
  conflict_.reset();
  compared_.reset();
  since_ns_.reset();
  estimates_ = 0;
}

void ExposureChoice::compare(TimeNs stamp_ns, const GivenExposure& given, bool has_estimate) {
  if (!compared_ || !is_same(*compared_, given) || (since_ns_ && stamp_ns < *since_ns_)) forget_conflict();
  compared_ = given;
  const std::optional<ExposureFilter::State> state = filter_of(given).state();
  if (!state) return;
  const TimeNs images_ns = *estimate_instead(given);
  if (conflict_) {
    conflict_->given = given;
    conflict_->images_ns = images_ns;
  }
  if (!has_estimate || state->log_stddev > kSureToContradict) return;
  const double log_ratio = std::log(static_cast<double>(images_ns) / static_cast<double>(given.exposure_ns));
  const bool says_otherwise = conflict_ ? std::abs(log_ratio) < kAgrees : std::abs(log_ratio) > kContradicts;
  if (!says_otherwise) {
    since_ns_.reset();
    return;
  }
  if (!since_ns_) {
    since_ns_ = stamp_ns;
    estimates_ = 0;
  }
  if (++estimates_ < kContradictingEstimates || stamp_ns - *since_ns_ < kContradictsForNs) return;
  since_ns_.reset();
  if (conflict_) {
    conflict_.reset();
    return;
  }
  const bool replaced = policy_ == OnExposureConflict::IMAGES && given.origin == ExposureOrigin::PARAMETER;
  conflict_ = ExposureConflict{given, images_ns, replaced};
}

void ExposureChoice::reset() {
  const OnExposureConflict policy = policy_;
  *this = ExposureChoice();
  policy_ = policy;
}

}  // namespace gyro_deblur
