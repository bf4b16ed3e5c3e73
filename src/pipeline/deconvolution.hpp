// Space-variant deconvolution: a 1-D kernel along a line for every block (paper sections IV-A and IV-B).
#pragma once

#include <opencv2/core.hpp>

#include "engine/engine.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/image_format.hpp"
#include "gyro_deblur/options.hpp"
#include "gyro_deblur/pixel_mask.hpp"
#include "inverse/filter_bank.hpp"

namespace gyro_deblur {

/// With Regularization::ADAPTIVE: sets noise_to_texture of each DEBLURRED block of `field`, by which make_filter_grid()
/// chooses the noise-to-signal ratio, and sets the status of blocks that filtering would make worse to NOISY. Does
/// nothing for other regularizations, or if field.noise is not known.
/// @param luminance  CV_8UC1 of the field's size
/// @param mask       empty, or of the field's size: of the pixels that noise is found in
void adapt_regularization(const cv::Mat& luminance, const FilterBank& bank, FrameBlur& field, int threads = 0,
                          const PixelMask& mask = {});

/// The filters that deblur `field`: for DEBLURRED blocks of at least kMinKernelExtentPx the bank's kernels, or own ones
/// where the path is non-uniform, made on at most `threads` threads (0: one for each core); 2-D inverses where
/// it is curved, or `in_2d` for all of them; none for the others. Lives no longer than the bank.
FilterGrid make_filter_grid(const FrameBlur& field, const FilterBank& bank, int threads = 0, bool in_2d = false);

/// Deblurs the DEBLURRED blocks of `field` and copies the rest bit for bit; alpha, and the colours of YUV 4:2:2, are
/// copied; Bayer mosaics are filtered plane by plane with half the extent.
/// Preconditions: image has the field's size and a type that fits `layout`. `dst` as for Engine::filter,
/// `threads` as for make_filter_grid.
/// Returns Engine::fallback_counts(); of a mosaic the largest number of any plane, for a block is filtered in the same
/// way in each.
FallbackCounts deconvolve(const cv::Mat& image, PixelLayout layout, const FrameBlur& field, const FilterBank& bank,
                          Engine& engine, cv::Mat& dst, int threads = 0);

/// Computes ahead the kernels of all extents that the options allow at uniform speed, of mosaics too, and the engine's
/// data for them, so that the first frame of an extent takes no longer than later ones. Takes about 0.1 s and 20 MB up
/// to 150 px.
void prepare_deconvolution(const BlurFieldOptions& options, const FilterBank& bank, Engine& engine, int threads = 0);

/// Adds to `all` what another pass over the same blocks found: for each reason the larger number.
void keep_larger(const FallbackCounts& of_pass, FallbackCounts& all);

}  // namespace gyro_deblur
