// Embree beside our tree: holds one mesh and sets of rays, and does what the bench tells it, one command a line.
//
// Build: apt-get install libembree-dev g++; g++ -std=c++17 -O3 -march=native embree.cpp -o embree -lembree3 -lpthread
// Run:   ./embree FILE, then commands on standard input. A program that waits for commands, rather than one that
//        measures on its own, lets the bench take turns: both sides meet the same mood of the machine.
//
//   build THREADS               builds the tree anew     answer SECONDS BYTES
//   describe                    builds with statistics   Embree's own lines, then: answer
//   query SET WIDTH THREADS     SET of the file's        answer SECONDS HITS SUM_OF_T
//
// SET 0 and 1 are asked for the closest hit, SET 2 for any hit; SET 0 is said to be coherent. WIDTH is 1 or 8.
// FILE, little endian: u32 vertices, u32 triangles, u32 rays of each of the three sets; f32[3] a vertex;
// u32[3] a triangle; then the rays of set 0, 1, 2: f32 origin[3], t_max, direction[3], unused.

#include <embree3/rtcore.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iostream>
#include <memory>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include <pmmintrin.h>
#include <xmmintrin.h>

namespace {

using Clock = std::chrono::steady_clock;

constexpr int kSets = 3;
constexpr int kShadowSet = 2;
constexpr unsigned kLanes = 8;
// Rays a thread takes at a time, as on our side.
constexpr size_t kChunk = 1024;

struct FileRay {
    float origin[3];
    float t_max;
    float direction[3];
    float unused;
};
static_assert(sizeof(FileRay) == 32, "the file's layout");

struct Subject {
    std::vector<float> vertices;
    std::vector<uint32_t> indices;
    std::vector<FileRay> rays[kSets];
};

struct Answer {
    size_t hits = 0;
    double sum_of_t = 0.0;
};

double seconds_since(Clock::time_point start) {
    return std::chrono::duration<double>(Clock::now() - start).count();
}

// Embree asks for this on every thread that uses it: denormal numbers cost a hundred cycles each.
void flush_denormals() {
    _MM_SET_FLUSH_ZERO_MODE(_MM_FLUSH_ZERO_ON);
    _MM_SET_DENORMALS_ZERO_MODE(_MM_DENORMALS_ZERO_ON);
}

template <typename T>
bool read_all(std::ifstream& file, std::vector<T>& items, size_t count) {
    items.resize(count);
    return bool(file.read(reinterpret_cast<char*>(items.data()), std::streamsize(count * sizeof(T))));
}

bool read_subject(const char* path, Subject& subject) {
    std::ifstream file(path, std::ios::binary);
    uint32_t counts[2 + kSets];
    if (!file.read(reinterpret_cast<char*>(counts), sizeof counts)) return false;
    if (!read_all(file, subject.vertices, size_t(counts[0]) * 3)) return false;
    if (!read_all(file, subject.indices, size_t(counts[1]) * 3)) return false;
    for (int set = 0; set < kSets; set++)
        if (!read_all(file, subject.rays[set], counts[2 + set])) return false;
    return true;
}

// A device and the scene that was built on it.
class Tree {
public:
    Tree(const Subject& subject, const std::string& config) {
        device_ = rtcNewDevice(config.c_str());
        rtcSetDeviceMemoryMonitorFunction(
            device_,
            [](void* bytes, ssize_t change, bool) {
                static_cast<std::atomic<ssize_t>*>(bytes)->fetch_add(change);
                return true;
            },
            &bytes_);
        scene_ = rtcNewScene(device_);
        // What our build is measured against: a full SAH build without spatial splits.
        rtcSetSceneBuildQuality(scene_, RTC_BUILD_QUALITY_MEDIUM);
        RTCGeometry mesh = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
        void* vertices = rtcSetNewGeometryBuffer(mesh, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12,
                                                 subject.vertices.size() / 3);
        std::memcpy(vertices, subject.vertices.data(), subject.vertices.size() * sizeof(float));
        void* indices = rtcSetNewGeometryBuffer(mesh, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12,
                                                subject.indices.size() / 3);
        std::memcpy(indices, subject.indices.data(), subject.indices.size() * sizeof(uint32_t));
        // Copying the mesh is no part of building: our side does not count it either.
        const ssize_t before = bytes_;
        const auto start = Clock::now();
        rtcCommitGeometry(mesh);
        rtcAttachGeometry(scene_, mesh);
        rtcCommitScene(scene_);
        build_seconds_ = seconds_since(start);
        tree_bytes_ = bytes_ - before;
        rtcReleaseGeometry(mesh);
    }
    ~Tree() {
        rtcReleaseScene(scene_);
        rtcReleaseDevice(device_);
    }
    Tree(const Tree&) = delete;
    Tree& operator=(const Tree&) = delete;

    RTCScene scene() const { return scene_; }
    double build_seconds() const { return build_seconds_; }
    ssize_t tree_bytes() const { return tree_bytes_; }
    RTCError error() const { return rtcGetDeviceError(device_); }

private:
    RTCDevice device_ = nullptr;
    RTCScene scene_ = nullptr;
    std::atomic<ssize_t> bytes_{0};
    double build_seconds_ = 0.0;
    ssize_t tree_bytes_ = 0;
};

// How one set of rays is asked.
struct Query {
    RTCScene scene;
    bool coherent;
    bool any_hit;
};

RTCIntersectContext context_of(const Query& query) {
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    context.flags =
        query.coherent ? RTC_INTERSECT_CONTEXT_FLAG_COHERENT : RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
    return context;
}

Answer ask_one_by_one(const Query& query, const FileRay* rays, size_t count) {
    RTCIntersectContext context = context_of(query);
    Answer answer;
    for (size_t i = 0; i < count; i++) {
        const FileRay& from = rays[i];
        RTCRayHit to;
        to.ray.org_x = from.origin[0], to.ray.org_y = from.origin[1], to.ray.org_z = from.origin[2];
        to.ray.dir_x = from.direction[0], to.ray.dir_y = from.direction[1], to.ray.dir_z = from.direction[2];
        to.ray.tnear = 0.0f, to.ray.tfar = from.t_max, to.ray.time = 0.0f;
        to.ray.mask = ~0u, to.ray.id = 0, to.ray.flags = 0;
        if (query.any_hit) {
            rtcOccluded1(query.scene, &context, &to.ray);
            answer.hits += to.ray.tfar < 0.0f;
        } else {
            to.hit.geomID = RTC_INVALID_GEOMETRY_ID;
            to.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
            rtcIntersect1(query.scene, &context, &to);
            if (to.hit.geomID != RTC_INVALID_GEOMETRY_ID) {
                answer.hits++;
                answer.sum_of_t += to.ray.tfar;
            }
        }
    }
    return answer;
}

// Turning rays into lanes is counted: whoever traces packets has to do it.
Answer ask_by_eight(const Query& query, const FileRay* rays, size_t count) {
    RTCIntersectContext context = context_of(query);
    Answer answer;
    for (size_t first = 0; first < count; first += kLanes) {
        const unsigned lanes = unsigned(std::min<size_t>(kLanes, count - first));
        alignas(32) int valid[kLanes];
        RTCRayHit8 to;
        for (unsigned lane = 0; lane < kLanes; lane++) {
            valid[lane] = lane < lanes ? -1 : 0;
            const FileRay& from = rays[first + std::min(lane, lanes - 1)];
            to.ray.org_x[lane] = from.origin[0];
            to.ray.org_y[lane] = from.origin[1];
            to.ray.org_z[lane] = from.origin[2];
            to.ray.dir_x[lane] = from.direction[0];
            to.ray.dir_y[lane] = from.direction[1];
            to.ray.dir_z[lane] = from.direction[2];
            to.ray.tnear[lane] = 0.0f;
            to.ray.tfar[lane] = from.t_max;
            to.ray.time[lane] = 0.0f;
            to.ray.mask[lane] = ~0u;
            to.ray.id[lane] = lane;
            to.ray.flags[lane] = 0;
            to.hit.geomID[lane] = RTC_INVALID_GEOMETRY_ID;
            to.hit.instID[0][lane] = RTC_INVALID_GEOMETRY_ID;
        }
        if (query.any_hit) {
            rtcOccluded8(valid, query.scene, &context, &to.ray);
            for (unsigned lane = 0; lane < lanes; lane++) answer.hits += to.ray.tfar[lane] < 0.0f;
        } else {
            rtcIntersect8(valid, query.scene, &context, &to);
            for (unsigned lane = 0; lane < lanes; lane++) {
                if (to.hit.geomID[lane] == RTC_INVALID_GEOMETRY_ID) continue;
                answer.hits++;
                answer.sum_of_t += to.ray.tfar[lane];
            }
        }
    }
    return answer;
}

struct Timed {
    double seconds;
    Answer answer;
};

// The calling thread works too; the others wait at a gate, so that starting them is not counted.
Timed ask(const Query& query, const std::vector<FileRay>& rays, int width, int thread_count) {
    const auto ask_chunk = width == 8 ? ask_by_eight : ask_one_by_one;
    std::atomic<size_t> next_chunk{0};
    std::atomic<int> waiting{0};
    std::atomic<bool> open{false};
    std::vector<Answer> answers(size_t(thread_count), Answer{});
    const auto work = [&](int thread) {
        Answer mine;
        for (;;) {
            const size_t first = kChunk * next_chunk.fetch_add(1);
            if (first >= rays.size()) break;
            const Answer of_chunk = ask_chunk(query, &rays[first], std::min(kChunk, rays.size() - first));
            mine.hits += of_chunk.hits;
            mine.sum_of_t += of_chunk.sum_of_t;
        }
        answers[size_t(thread)] = mine;
    };
    std::vector<std::thread> threads;
    for (int thread = 1; thread < thread_count; thread++)
        threads.emplace_back([&, thread] {
            flush_denormals();
            waiting++;
            while (!open) std::this_thread::yield();
            work(thread);
        });
    while (waiting < thread_count - 1) std::this_thread::yield();
    const auto start = Clock::now();
    open = true;
    work(0);
    for (std::thread& thread : threads) thread.join();
    Timed timed{seconds_since(start), Answer{}};
    for (const Answer& answer : answers) {
        timed.answer.hits += answer.hits;
        timed.answer.sum_of_t += answer.sum_of_t;
    }
    return timed;
}

}  // namespace

int main(int argument_count, char** arguments) {
    flush_denormals();
    Subject subject;
    if (argument_count != 2 || !read_subject(arguments[1], subject)) {
        std::cerr << "usage: embree FILE, and the FILE must be whole\n";
        return 1;
    }
    std::unique_ptr<Tree> tree;
    std::string line;
    while (std::getline(std::cin, line)) {
        std::istringstream words(line);
        std::string command;
        words >> command;
        if (command == "build") {
            int threads = 1;
            words >> threads;
            // The old device goes first: Embree sizes its threads by the largest device alive.
            tree.reset();
            tree = std::make_unique<Tree>(subject, "threads=" + std::to_string(threads));
            if (tree->error() != RTC_ERROR_NONE) return 2;
            std::printf("answer %.9f %zd\n", tree->build_seconds(), tree->tree_bytes());
        } else if (command == "describe") {
            tree.reset();
            tree = std::make_unique<Tree>(subject, "threads=1,verbose=2");
            std::cout.flush();
            std::printf("\nanswer\n");
        } else if (command == "query" && tree) {
            int set = 0, width = 1, threads = 1;
            words >> set >> width >> threads;
            if (set < 0 || set >= kSets || threads < 1) return 2;
            const Query query{tree->scene(), set == 0, set == kShadowSet};
            const Timed timed = ask(query, subject.rays[set], width, threads);
            std::printf("answer %.9f %zu %.9e\n", timed.seconds, timed.answer.hits, timed.answer.sum_of_t);
        } else {
            std::cerr << "what is '" << line << "'?\n";
            return 2;
        }
        std::fflush(stdout);
    }
    return 0;
}
