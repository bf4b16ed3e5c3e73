// Takes values from the bytes that a fuzzer gives; zeros when they run out.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>

namespace gyro_deblur::fuzz {

class InputBytes {
 public:
  InputBytes(const std::uint8_t* data, std::size_t size) : data_(data), size_(size) {}

  bool empty() const { return size_ == 0; }
  const std::uint8_t* data() const { return data_; }
  std::size_t size() const { return size_; }

  template <typename T>
  T take() {
    T value{};
    const std::size_t count = std::min(sizeof(T), size_);
    if (count > 0) std::memcpy(&value, data_, count);
    skip(count);
    return value;
  }

  /// One of `count` choices.
  std::size_t choice(std::size_t count) { return take<std::uint8_t>() % count; }

  std::string text(std::size_t longest) {
    const std::size_t count = std::min<std::size_t>(take<std::uint8_t>() % (longest + 1), size_);
    std::string text(reinterpret_cast<const char*>(data_), count);
    skip(count);
    return text;
  }

  void skip(std::size_t count) {
    count = std::min(count, size_);
    data_ += count;
    size_ -= count;
  }

 private:
  const std::uint8_t* data_;
  std::size_t size_;
};

}  // namespace gyro_deblur::fuzz
