#include "core/irregular/aligned_buffer.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <limits>
#include <utility>

namespace shadowfit::irregular {
namespace {

constexpr size_t kLarge = size_t{3} << 20;

template <typename T>
void FillAndCheck(AlignedBuffer<T>* buffer, size_t count) {
  for (size_t i = 0; i < count; ++i) (*buffer)[i] = static_cast<T>(i * 2654435761u);
  for (size_t i = 0; i < count; ++i) ASSERT_EQ((*buffer)[i], static_cast<T>(i * 2654435761u)) << i;
}

TEST(AlignedBuffer, GrowsOnlyAndLiesOnACacheLine) {
  AlignedBuffer<uint32_t> buffer;
  EXPECT_TRUE(buffer.data() == nullptr);
  for (const size_t count : {size_t{1}, size_t{100}, kLarge, 2 * kLarge + 7}) {
    ASSERT_TRUE(buffer.Reserve(count));
    EXPECT_EQ(buffer.capacity(), count);
    EXPECT_EQ(reinterpret_cast<uintptr_t>(buffer.data()) % 64, 0u);
    FillAndCheck(&buffer, count);
  }
  const uint32_t* const before = buffer.data();
  ASSERT_TRUE(buffer.Reserve(5));
  EXPECT_TRUE(buffer.data() == before);
  EXPECT_EQ(buffer.MemoryBytes(), (2 * kLarge + 7) * sizeof(uint32_t));
}

TEST(AlignedBuffer, IsEmptyAndServesAgainWhereMemoryRanOut) {
  AlignedBuffer<uint8_t> buffer;
  ASSERT_TRUE(buffer.Reserve(kLarge));
  EXPECT_FALSE(buffer.Reserve(std::numeric_limits<size_t>::max() / 4));
  EXPECT_EQ(buffer.capacity(), 0u);
  for (const size_t count : {size_t{10}, kLarge}) {
    ASSERT_TRUE(buffer.Reserve(count));
    FillAndCheck(&buffer, count);
  }
}

TEST(AlignedBuffer, Moves) {
  for (const size_t count : {size_t{10}, kLarge}) {
    AlignedBuffer<uint8_t> from;
    ASSERT_TRUE(from.Reserve(count));
    FillAndCheck(&from, count);
    const uint8_t* const data = from.data();
    const AlignedBuffer<uint8_t> to = std::move(from);
    EXPECT_TRUE(to.data() == data);
    EXPECT_EQ(to[7], static_cast<uint8_t>(7 * 2654435761u));
  }
}

}  // namespace
}  // namespace shadowfit::irregular
