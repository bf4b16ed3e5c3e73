#include "sync/per_image_messages.hpp"

#include <functional>

#include <gtest/gtest.h>

namespace gyro_deblur::per_image_messages_test {
namespace {

constexpr std::size_t kCapacity = 100;
constexpr TimeNs kPeriod = 33'000'000, kTimeout = 500'000'000;
using Store = PerImageMessages<int, std::equal_to<>>;

/// Values for the stamps 0, 1, 2, ... periods; -1: lost.
Store store_of(std::initializer_list<int> values, TimeNs begin_ns = 0) {
  Store store;
  TimeNs stamp_ns = begin_ns;
  for (const int value : values) {
    if (value >= 0) store.add(stamp_ns, value, kCapacity);
    stamp_ns += kPeriod;
  }
  return store;
}

const int* between(const Store& store, TimeNs index) { return store.find_if_neighbours_agree(index * kPeriod); }

TEST(PerImageMessages, OneThatIsLostIsThatOfNeighboursThatAgree) {
  EXPECT_EQ(between(store_of({7, -1}), 1), nullptr) << "none has come after it";
  ASSERT_NE(between(store_of({7, -1, 7}), 1), nullptr);
  EXPECT_EQ(*between(store_of({7, -1, 7}), 1), 7);
  EXPECT_EQ(between(store_of({7, -1, 8}), 1), nullptr);
  ASSERT_NE(between(store_of({7, -1, -1, 7}), 2), nullptr) << "two in a row";
  EXPECT_EQ(between(store_of({-1, 7}), 0), nullptr) << "nothing to compare with";
  EXPECT_NE(between(store_of({-1, 7, 7}), 0), nullptr);
  EXPECT_EQ(between(store_of({-1, 7, 8}), 0), nullptr);
}

TEST(PerImageMessages, RepetitionIsNoSecondWitness) {
  Store store;
  store.add(kPeriod, 7, kCapacity);
  store.add(kPeriod, 7, kCapacity);
  EXPECT_EQ(store.find_if_neighbours_agree(0), nullptr);
  EXPECT_EQ(store.later(0), 1u);
}

TEST(PerImageMessages, FarStampsSayNothing) {
  Store store = store_of({7, -1});
  store.add(100 * kTimeout, 7, kCapacity);
  EXPECT_EQ(between(store, 1), nullptr);
  EXPECT_EQ(store.later(kPeriod), 0u);
  store.add(2 * kPeriod, 7, kCapacity);
  EXPECT_NE(between(store, 1), nullptr);
}

TEST(PerImageMessages, LastServesWhereNothingChanged) {
  const auto last = [](const Store& store) { return store.find_last_unchanged(3 * kPeriod); };
  EXPECT_EQ(last(store_of({-1, -1, 7, -1})), nullptr) << "one alone may be the change";
  EXPECT_EQ(last(store_of({-1, 6, 7, -1})), nullptr);
  ASSERT_NE(last(store_of({7, -1, 7, -1})), nullptr);
  EXPECT_EQ(*last(store_of({7, -1, 7, -1})), 7);
  EXPECT_EQ(last(store_of({7, -1, 7, -1, 8})), nullptr) << "it changed hereabouts";
}

/// Images of which some get their message, `late_ns` after them.
class StreamLivenessTest : public testing::Test {
 protected:
  void image(bool gets_it, TimeNs late_ns = 0) {
    store_.expect(now_ns_, now_ns_);
    store_.update(now_ns_ + late_ns, kTimeout);
    if (gets_it) store_.add(now_ns_, 0, kCapacity);
    store_.update(now_ns_ + late_ns, kTimeout);
    now_ns_ += kPeriod;
  }
  TimeNs now_ns_ = kPeriod;
  Store store_;
};

TEST_F(StreamLivenessTest, SilenceEndsWaitingAfterTheTimeout) {
  while (store_.awaited() && now_ns_ < kTimeout * 10) image(false);
  EXPECT_GE(now_ns_, kTimeout + static_cast<TimeNs>(StreamLiveness::kMissesEndWaiting) * kPeriod);
  EXPECT_LE(now_ns_, kTimeout + static_cast<TimeNs>(StreamLiveness::kMissesEndWaiting + 3) * kPeriod);
  image(true);
  EXPECT_TRUE(store_.awaited()) << "its first message of all";
}

TEST_F(StreamLivenessTest, MessagesThatComeAgainBringWaitingBack) {
  image(true);
  while (store_.awaited() && now_ns_ < kTimeout * 10) image(false);
  ASSERT_FALSE(store_.awaited());
  for (int i = 0; i < 30; ++i) image(false);
  // Later than those without would wait, but in time.
  for (std::size_t i = 0; i < StreamLiveness::kHitsBringItBack; ++i) {
    EXPECT_FALSE(store_.awaited());
    image(true, kPeriod / 2);
    now_ns_ += kTimeout;
    store_.update(now_ns_, kTimeout);
  }
  EXPECT_TRUE(store_.awaited());
}

TEST_F(StreamLivenessTest, SparseOnesDoNot) {
  for (int i = 0; i < 60; ++i) image(i % 10 == 0);
  for (int i = 0; i < 100; ++i) {
    image(i % 10 == 0);
    EXPECT_FALSE(store_.awaited()) << i;
  }
}

TEST_F(StreamLivenessTest, LossesHereAndThereChangeNothing) {
  for (int i = 0; i < 300; ++i) {
    image(i % 3 == 0);
    EXPECT_TRUE(store_.awaited()) << i;
  }
}

TEST_F(StreamLivenessTest, OutOfOrderIsNoMiss) {
  for (TimeNs i = 0; i < 90; i += 3) {
    for (TimeNs k = 0; k < 3; ++k) store_.expect((i + k) * kPeriod, (i + k) * kPeriod);
    for (const TimeNs k : {1, 2, 0}) {  // one behind the next two
      store_.add((i + k) * kPeriod, 0, kCapacity);
      store_.update((i + 2) * kPeriod, kTimeout);
    }
  }
  EXPECT_TRUE(store_.awaited());
}

TEST_F(StreamLivenessTest, ClockThatIsSetBackDoesNotKeepImages) {
  store_.expect(0, 10 * kTimeout);
  store_.update(kPeriod, kTimeout);
  for (int i = 1; i < 30; ++i) image(false);
  EXPECT_FALSE(store_.awaited());
}

}  // namespace
}  // namespace gyro_deblur::per_image_messages_test
