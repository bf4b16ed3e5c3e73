#include "live.hpp"

#include <condition_variable>
#include <mutex>
#include <thread>

#include "base/time_slice.hpp"

namespace gyro_deblur::test {

void play_live(const std::vector<Delivery>& deliveries, TimeNs round_ns, TimeNs end_ns, const LiveClock& clock,
               const std::function<void(const Delivery&, TimeNs)>& deliver, Processor* processor,
               const Processor::Sink& sink) {
  // As the nodelet's: timeouts come without a message.
  constexpr std::chrono::milliseconds kPollPeriod{20};
  std::mutex mutex;
  std::condition_variable wakes;
  bool has_news = false, ended = false;
  std::thread camera([&] {
    for (TimeNs shift_ns = 0;; shift_ns += round_ns) {
      for (const Delivery& delivery : deliveries) {
        if (delivery.at_ns + shift_ns >= end_ns) {
          const std::lock_guard<std::mutex> lock(mutex);
          ended = true;
          wakes.notify_one();
          return;
        }
        std::this_thread::sleep_until(clock.when(delivery.at_ns + shift_ns));
        deliver(delivery, shift_ns);
        if (processor->waiting() == 0) continue;
        {
          const std::lock_guard<std::mutex> lock(mutex);
          has_news = true;
        }
        wakes.notify_one();
      }
    }
  });
  ask_for_time_slice_of_a_frame();
  std::unique_lock<std::mutex> lock(mutex);
  while (!ended) {
    wakes.wait_for(lock, kPollPeriod, [&] { return has_news || ended; });
    has_news = false;
    lock.unlock();
    processor->advance(sink);
    lock.lock();
  }
  lock.unlock();
  camera.join();
  do {
    processor->finish(sink);
  } while (processor->waiting() > 0);
}

}  // namespace gyro_deblur::test
