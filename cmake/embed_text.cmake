# Writes a text file into a C++ source as a constant: cmake -D INPUT=... -D OUTPUT=... -D VARIABLE=... -P embed_text.cmake
file(READ "${INPUT}" text)
get_filename_component(name "${INPUT}" NAME)
file(WRITE "${OUTPUT}" "// Made from ${name}.
namespace gyro_deblur {
extern const char ${VARIABLE}[];
const char ${VARIABLE}[] = R\"EMBEDDED(${text})EMBEDDED\";
}  // namespace gyro_deblur
")
