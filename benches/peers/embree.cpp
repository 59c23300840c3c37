// Embree's side of benches/rays.rs: traces the rays that the bench wrote, one at a time on one thread, and is asked for each
// round through standard input, so that rounds of both sides alternate.
//
//   embree fast|robust MESH RAYS...
//
// MESH: u32 vertices, u32 triangles, then f32 x 3 a vertex and u32 x 3 a triangle.
// RAYS: u32 0 (any hit) or 1 (closest), u32 rays, then f32 x 7 a ray: origin, direction, limit.
// Requests, a line each: `run I FROM TO` traces these rays of set I and answers with seconds; `hits I PATH` writes u32 triangle
// (or -1; 0 for any hit) and f32 distance of each of its rays, once they have all been traced.

#include <embree3/rtcore.h>
#include <pmmintrin.h>
#include <xmmintrin.h>

#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <limits>
#include <string>
#include <vector>

struct Input {
    float origin[3], direction[3], limit;
};

struct Hit {
    uint32_t triangle;
    float distance;
};

struct Set {
    bool closest;
    std::vector<Input> rays;
    std::vector<Hit> hits;
};

static void fail(const std::string& what) {
    std::cerr << "embree: " << what << "\n";
    std::exit(1);
}

template <typename T>
static void read(std::ifstream& file, T* to, size_t count) {
    if (!file.read(reinterpret_cast<char*>(to), count * sizeof(T))) fail("a file is too short");
}

static Set read_set(const char* path) {
    std::ifstream file(path, std::ios::binary);
    uint32_t head[2];
    read(file, head, 2);
    Set set{head[0] == 1, std::vector<Input>(head[1]), std::vector<Hit>(head[1])};
    read(file, set.rays.data(), set.rays.size());
    return set;
}

static RTCScene build(RTCDevice device, const char* path, bool robust) {
    std::ifstream file(path, std::ios::binary);
    uint32_t head[2];
    read(file, head, 2);
    RTCGeometry mesh = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    auto* vertices = static_cast<float*>(
        rtcSetNewGeometryBuffer(mesh, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 3 * sizeof(float), head[0]));
    auto* triangles = static_cast<uint32_t*>(
        rtcSetNewGeometryBuffer(mesh, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 3 * sizeof(uint32_t), head[1]));
    read(file, vertices, 3 * size_t(head[0]));
    read(file, triangles, 3 * size_t(head[1]));
    RTCScene scene = rtcNewScene(device);
    rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_MEDIUM);
    rtcSetSceneFlags(scene, robust ? RTC_SCENE_FLAG_ROBUST : RTC_SCENE_FLAG_NONE);
    rtcSetGeometryBuildQuality(mesh, RTC_BUILD_QUALITY_MEDIUM);
    rtcCommitGeometry(mesh);
    rtcAttachGeometry(scene, mesh);
    rtcCommitScene(scene);
    return scene;
}

static void trace(RTCScene scene, Set& set, size_t from, size_t to) {
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    for (size_t i = from; i < to; i++) {
        const Input& in = set.rays[i];
        RTCRayHit ray = {};
        ray.ray = {in.origin[0], in.origin[1], in.origin[2], 0.0f, in.direction[0], in.direction[1], in.direction[2], 0.0f,
                   in.limit, ~0u, 0, 0};
        ray.hit.geomID = RTC_INVALID_GEOMETRY_ID;
        if (set.closest) {
            rtcIntersect1(scene, &context, &ray);
            bool hit = ray.hit.geomID != RTC_INVALID_GEOMETRY_ID;
            set.hits[i] = {hit ? ray.hit.primID : ~0u, hit ? ray.ray.tfar : 0.0f};
        } else {
            rtcOccluded1(scene, &context, &ray.ray);
            set.hits[i] = {ray.ray.tfar < 0.0f ? 0 : ~0u, 0.0f};
        }
    }
}

int main(int count, char** arguments) {
    if (count < 4) fail("wanted: embree fast|robust MESH RAYS...");
    _MM_SET_FLUSH_ZERO_MODE(_MM_FLUSH_ZERO_ON);
    _MM_SET_DENORMALS_ZERO_MODE(_MM_DENORMALS_ZERO_ON);
    using Clock = std::chrono::steady_clock;
    auto seconds = [](Clock::time_point from) { return std::chrono::duration<double>(Clock::now() - from).count(); };
    RTCDevice device = rtcNewDevice("threads=1");
    if (!device) fail("no device");
    auto began = Clock::now();
    RTCScene scene = build(device, arguments[2], std::string(arguments[1]) == "robust");
    std::cout << "built " << seconds(began) << " Embree " << rtcGetDeviceProperty(device, RTC_DEVICE_PROPERTY_VERSION_MAJOR)
              << "." << rtcGetDeviceProperty(device, RTC_DEVICE_PROPERTY_VERSION_MINOR) << std::endl;
    std::vector<Set> sets;
    for (int i = 3; i < count; i++) sets.push_back(read_set(arguments[i]));
    std::string request;
    size_t index;
    while (std::cin >> request >> index) {
        Set& set = sets.at(index);
        if (request == "run") {
            size_t from, to;
            if (!(std::cin >> from >> to) || from > to || to > set.rays.size()) fail("no such rays");
            auto began = Clock::now();
            trace(scene, set, from, to);
            std::cout << seconds(began) << std::endl;
        } else if (request == "hits") {
            std::string path;
            std::cin >> path;
            std::ofstream file(path, std::ios::binary);
            file.write(reinterpret_cast<const char*>(set.hits.data()), set.hits.size() * sizeof(Hit));
            file.close();
            std::cout << "written" << std::endl;
        } else {
            fail("no such request: " + request);
        }
    }
    rtcReleaseScene(scene);
    rtcReleaseDevice(device);
}
