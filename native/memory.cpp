#include "memory.hpp"

#include <cstdlib>
#include <mutex>
#include <new>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace neurotact {
namespace {

constexpr size_t kPage = size_t{1} << 21;  // huge pages spare the table walks of long rasters
constexpr int kSpares = 4;

struct Spare {
    char* data = nullptr;
    size_t bytes = 0;
};

std::mutex guard;
Spare spares[kSpares];

char* fresh(size_t bytes) {
    const size_t alignment = bytes >= 2 * kPage ? kPage : 64;
    void* data = std::aligned_alloc(alignment, (bytes + alignment - 1) / alignment * alignment);
    if (data == nullptr) throw std::bad_alloc();
#if defined(__linux__)
    if (alignment == kPage) madvise(data, bytes, MADV_HUGEPAGE);
#endif
    return static_cast<char*>(data);
}

}  // namespace

Block::Block(size_t bytes) : data_(nullptr), bytes_(bytes ? bytes : 64) {
    {
        std::lock_guard<std::mutex> lock(guard);
        Spare* best = nullptr;  // the smallest that is large enough, and not more than twice too large
        for (Spare& spare : spares)
            if (spare.bytes >= bytes_ && spare.bytes / 2 <= bytes_ && (!best || spare.bytes < best->bytes)) best = &spare;
        if (best) {
            data_ = best->data;
            bytes_ = best->bytes;
            *best = Spare{};
        }
    }
    if (!data_) data_ = fresh(bytes_);
}

Block::~Block() {
    char* unwanted = data_;
    {
        std::lock_guard<std::mutex> lock(guard);
        Spare* place = &spares[0];  // an empty place, else the smallest block makes room
        for (Spare& spare : spares)
            if (spare.bytes < place->bytes) place = &spare;
        if (place->bytes < bytes_) {
            unwanted = place->data;
            *place = Spare{data_, bytes_};
        }
    }
    std::free(unwanted);
}

void free_spare_blocks() {
    std::lock_guard<std::mutex> lock(guard);
    for (Spare& spare : spares) {
        std::free(spare.data);
        spare = Spare{};
    }
}

}  // namespace neurotact
