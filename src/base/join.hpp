// Words as a list in a sentence.
#pragma once

#include <cstddef>
#include <iterator>
#include <string>

namespace gyro_deblur {

/// "a, b, c", or with a conjunction "a, b and c". Empty without words.
/// @param words  any range of strings
template <typename Words>
std::string join(const Words& words, const std::string& conjunction = "") {
  const auto count = static_cast<std::size_t>(std::distance(std::begin(words), std::end(words)));
  std::string text;
  std::size_t i = 0;
  for (const auto& word : words) {
    if (i > 0) text += conjunction.empty() || i + 1 < count ? ", " : " " + conjunction + " ";
    text += word;
    ++i;
  }
  return text;
}

}  // namespace gyro_deblur
