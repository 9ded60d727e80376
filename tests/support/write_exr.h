#pragma once

#include <OpenImageIO/imageio.h>
#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <vector>

#include "core/frame/images.h"

namespace shadowfit::testing {

/// A picture file of one channel, row 0 at the top.
template <typename T>
void WriteExr(const std::string& path, OIIO::TypeDesc type, const ImageView<T>& image) {
  std::vector<T> pixels;
  for (int y = image.height - 1; y >= 0; --y)
    pixels.insert(pixels.end(), image.Row(y), image.Row(y) + image.width);
  const auto output = OIIO::ImageOutput::create(path);
  OIIO::ImageSpec spec(image.width, image.height, 1, type);
  ASSERT_TRUE(output->open(path, spec)) << output->geterror();
  ASSERT_TRUE(output->write_image(type, pixels.data())) << output->geterror();
  ASSERT_TRUE(output->close());
}

}  // namespace shadowfit::testing
