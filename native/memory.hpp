// Memory that is kept between calls: a training step asks for the same sizes again and again, and fresh pages
// from the system cost more than the kernel that fills them.
#pragma once

#include <cstddef>
#include <cstdint>

namespace neurotact {

// A block of at least `bytes`, 64-byte aligned, not cleared; back to the pool when it goes.
class Block {
public:
    explicit Block(size_t bytes);
    ~Block();
    Block(const Block&) = delete;
    Block& operator=(const Block&) = delete;
    char* data() const { return data_; }

private:
    char* data_;
    size_t bytes_;
};

// Gives every spare block back to the system.
void free_spare_blocks();

// Cuts a block into arrays, each on its own cache lines. Without a block it only adds up their sizes.
class Carver {
public:
    explicit Carver(char* at = nullptr) : start_(at), offset_(0) {}
    template <class T>
    T* take(int64_t count) {
        T* here = start_ ? reinterpret_cast<T*>(start_ + offset_) : nullptr;
        offset_ += ((static_cast<size_t>(count) * sizeof(T) + 63) / 64) * 64;
        return here;
    }
    size_t bytes() const { return offset_; }

private:
    char* start_;
    size_t offset_;
};

}  // namespace neurotact
