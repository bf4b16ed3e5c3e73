// A list in a sentence.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace gyro_deblur {

/// "a, b LAST c"
inline std::string listing(const std::vector<std::string>& words, const std::string& last) {
  std::string text;
  for (std::size_t i = 0; i < words.size(); ++i) {
    if (i > 0) text += i + 1 < words.size() ? ", " : " " + last + " ";
    text += words[i];
  }
  return text;
}

}  // namespace gyro_deblur
