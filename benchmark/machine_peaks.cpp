#include "machine_peaks.hpp"

#include <omp.h>

#include <algorithm>
#include <chrono>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace gyro_deblur::benchmark {

#if defined(__x86_64__)
namespace {

// Short tries, so that some of them fall between what else the machine does.
constexpr int kTries = 25;
// Independent sums: two units of four cycles latency need 8; 12 leave room for 16 registers of AVX2.
constexpr int kSums = 12;

/// Best rate of `work`, which returns the amount it did on its thread and is called by all threads at once.
template <typename Work>
double best_rate(int threads, const Work& work) {
  double best = 0;
  for (int attempt = 0; attempt < kTries; ++attempt) {
    double amount = 0, slowest_s = 0;
#pragma omp parallel num_threads(threads) reduction(+ : amount) reduction(max : slowest_s)
    {
#pragma omp barrier
      const auto start = std::chrono::steady_clock::now();
      amount += work();
      slowest_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    }
    best = std::max(best, amount / slowest_s);
  }
  return best;
}

/// Keeps the compiler from dropping or merging what computes `value`.
template <typename Register>
inline __attribute__((always_inline)) void keep(Register& value) {
  asm volatile("" : "+v"(value));
}

constexpr int kRounds = 200000;

__attribute__((target("avx2,fma"))) double float_macs_avx2() {
  __m256 sums[kSums];
  __m256 a = _mm256_set1_ps(0.5f), b = _mm256_set1_ps(0.25f);
  for (auto& sum : sums) sum = _mm256_setzero_ps();
  for (int i = 0; i < kRounds; ++i) {
    keep(a);
    for (auto& sum : sums) sum = _mm256_fmadd_ps(a, b, sum);
  }
  for (auto& sum : sums) keep(sum);
  return 8.0 * kSums * kRounds;
}

// Products that are added by another instruction need a register each; more sums than this do not fit.
constexpr int kAddedSums = 6;

__attribute__((target("avx2,fma"))) double int16_macs_avx2() {
  __m256i sums[kAddedSums];
  __m256i a = _mm256_set1_epi16(3), b = _mm256_set1_epi16(5);
  for (auto& sum : sums) sum = _mm256_setzero_si256();
  for (int i = 0; i < kRounds; ++i) {
    for (auto& sum : sums) {
      keep(a);
      sum = _mm256_add_epi32(sum, _mm256_madd_epi16(a, b));
    }
  }
  for (auto& sum : sums) keep(sum);
  return 16.0 * kAddedSums * kRounds;
}

__attribute__((target("avx512f"))) double float_macs_avx512() {
  __m512 sums[kSums];
  __m512 a = _mm512_set1_ps(0.5f), b = _mm512_set1_ps(0.25f);
  for (auto& sum : sums) sum = _mm512_setzero_ps();
  for (int i = 0; i < kRounds; ++i) {
    keep(a);
    for (auto& sum : sums) sum = _mm512_fmadd_ps(a, b, sum);
  }
  for (auto& sum : sums) keep(sum);
  return 16.0 * kSums * kRounds;
}

__attribute__((target("avx512f,avx512vnni"))) double int16_macs_avx512() {
  __m512i sums[kSums];
  __m512i a = _mm512_set1_epi32(3 << 16 | 3), b = _mm512_set1_epi32(5 << 16 | 5);
  for (auto& sum : sums) sum = _mm512_setzero_si512();
  for (int i = 0; i < kRounds; ++i) {
    keep(a);
    for (auto& sum : sums) sum = _mm512_dpwssd_epi32(sum, a, b);
  }
  for (auto& sum : sums) keep(sum);
  return 32.0 * kSums * kRounds;
}

/// Loads every byte of a 64-byte aligned buffer whose size is a multiple of 512.
__attribute__((target("avx512f"))) void read_once_avx512(const char* from, std::size_t bytes) {
  for (std::size_t i = 0; i < bytes; i += 512) {
    for (std::size_t k = 0; k < 512; k += 64) {
      __m512i v = _mm512_load_si512(from + i + k);
      keep(v);
    }
  }
}

__attribute__((target("avx2"))) void read_once_avx2(const char* from, std::size_t bytes) {
  for (std::size_t i = 0; i < bytes; i += 256) {
    for (std::size_t k = 0; k < 256; k += 32) {
      __m256i v = _mm256_load_si256(reinterpret_cast<const __m256i*>(from + i + k));
      keep(v);
    }
  }
}

}  // namespace

std::vector<ArithmeticPeak> measure_arithmetic(int threads) {
  std::vector<ArithmeticPeak> peaks;
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) {
    peaks.push_back({"avx2", best_rate(threads, float_macs_avx2) / 1e9, best_rate(threads, int16_macs_avx2) / 1e9});
  }
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vnni")) {
    peaks.push_back(
        {"avx512", best_rate(threads, float_macs_avx512) / 1e9, best_rate(threads, int16_macs_avx512) / 1e9});
  }
  return peaks;
}

std::vector<BandwidthPeak> measure_bandwidth(int threads) {
  if (!__builtin_cpu_supports("avx2")) return {};
  const auto read_once = __builtin_cpu_supports("avx512f") ? read_once_avx512 : read_once_avx2;
  // Half of a common L1 (32 KiB), half of a common L2 (1 MiB), a share of L3, and more than any cache.
  std::vector<BandwidthPeak> peaks = {
      {"L1", 16u << 10, 0}, {"L2", 512u << 10, 0}, {"L3", 6u << 20, 0}, {"DRAM", 256u << 20, 0}};
  for (BandwidthPeak& peak : peaks) {
    const std::size_t bytes = peak.bytes_per_thread;
    const std::size_t repeats = std::max<std::size_t>(1, (64u << 20) / bytes);
    std::vector<std::vector<char>> buffers(threads);
#pragma omp parallel num_threads(threads)
    buffers[omp_get_thread_num()].assign(bytes + 64, 1);
    peak.gb_per_s = best_rate(threads,
                              [&] {
                                char* from = buffers[omp_get_thread_num()].data();
                                from += (64 - reinterpret_cast<std::uintptr_t>(from) % 64) % 64;
                                for (std::size_t r = 0; r < repeats; ++r) read_once(from, bytes);
                                return static_cast<double>(bytes) * repeats;
                              }) /
                    1e9;
  }
  return peaks;
}

#else

std::vector<ArithmeticPeak> measure_arithmetic(int) { return {}; }
std::vector<BandwidthPeak> measure_bandwidth(int) { return {}; }

#endif

}  // namespace gyro_deblur::benchmark
