// The tasks of user_tasks.py with PCL, which has no Python. `pcl_tasks FRAME FX FY CX CY` reads a frame of
// 640 x 480 uint16 in millimetres; then for each line of its input, `TASK FILE`, it does the task once, prints
// how long it took in seconds and writes the result to the file.

#include <chrono>
#include <fstream>
#include <iostream>
#include <limits>

#include <pcl/features/integral_image_normal.h>
#include <pcl/features/normal_3d.h>
#include <pcl/segmentation/organized_multi_plane_segmentation.h>

using Cloud = pcl::PointCloud<pcl::PointXYZ>;
using Normals = pcl::PointCloud<pcl::Normal>;
constexpr int kWidth = 640, kHeight = 480;
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

Cloud::Ptr cloud_of(const std::vector<uint16_t>& depth, float fx, float fy, float cx, float cy)
{
  Cloud::Ptr cloud(new Cloud(kWidth, kHeight));
  cloud->is_dense = false;
  for (int v = 0; v < kHeight; ++v) {
    for (int u = 0; u < kWidth; ++u) {
      const float z = depth[v * kWidth + u] > 0 ? depth[v * kWidth + u] * 1e-3f : kNaN;
      (*cloud)(u, v) = pcl::PointXYZ((u - cx) / fx * z, (v - cy) / fy * z, z);
    }
  }
  return cloud;
}

std::vector<float> tiles(const Cloud::Ptr& cloud)
{
  std::vector<float> planes;
  for (int top = 0; top < kHeight; top += 16) {
    for (int left = 0; left < kWidth; left += 16) {
      pcl::Indices valid;
      for (int i = 0; i < 256; ++i) {
        const int index = (top + i / 16) * kWidth + left + i % 16;
        if (pcl::isFinite((*cloud)[index])) valid.push_back(index);
      }
      Eigen::Vector4f plane = Eigen::Vector4f::Constant(kNaN);
      float curvature;
      if (valid.size() >= 128 && pcl::computePointNormal(*cloud, valid, plane, curvature))
        pcl::flipNormalTowardsViewpoint((*cloud)[valid[0]], 0.f, 0.f, 0.f, plane);
      planes.insert(planes.end(), plane.data(), plane.data() + 4);
    }
  }
  return planes;
}

using Estimation = pcl::IntegralImageNormalEstimation<pcl::PointXYZ, pcl::Normal>;

Normals::Ptr normals(const Cloud::Ptr& cloud, Estimation::NormalEstimationMethod method, float size)
{
  Estimation estimation;
  estimation.setNormalEstimationMethod(method);
  estimation.setMaxDepthChangeFactor(0.02f);
  estimation.setNormalSmoothingSize(size);
  estimation.setInputCloud(cloud);
  Normals::Ptr found(new Normals);
  estimation.compute(*found);
  return found;
}

std::vector<int32_t> segments(const Cloud::Ptr& cloud)
{
  pcl::OrganizedMultiPlaneSegmentation<pcl::PointXYZ, pcl::Normal, pcl::Label> segmentation;
  segmentation.setMinInliers(1000);
  segmentation.setAngularThreshold(pcl::deg2rad(3.0));
  segmentation.setDistanceThreshold(0.02);
  segmentation.setInputNormals(normals(cloud, Estimation::COVARIANCE_MATRIX, 10.f));
  segmentation.setInputCloud(cloud);
  std::vector<pcl::PlanarRegion<pcl::PointXYZ>, Eigen::aligned_allocator<pcl::PlanarRegion<pcl::PointXYZ>>> regions;
  std::vector<pcl::ModelCoefficients> coefficients;
  std::vector<pcl::PointIndices> inliers, label_indices, boundaries;
  pcl::PointCloud<pcl::Label>::Ptr found(new pcl::PointCloud<pcl::Label>);
  segmentation.segmentAndRefine(regions, coefficients, inliers, found, label_indices, boundaries);
  std::vector<int32_t> labels(kWidth * kHeight, 0);
  for (size_t i = 0; i < inliers.size(); ++i)
    for (const auto index : inliers[i].indices) labels[index] = static_cast<int32_t>(i) + 1;
  return labels;
}

template <typename T> void write(const std::string& path, const std::vector<T>& values)
{
  std::ofstream(path, std::ios::binary).write(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T));
}

int main(int, char** argv)
{
  std::vector<uint16_t> depth(kWidth * kHeight);
  std::ifstream(argv[1], std::ios::binary).read(reinterpret_cast<char*>(depth.data()), depth.size() * 2);
  std::string task, path;
  while (std::cin >> task >> path) {
    const auto start = std::chrono::steady_clock::now();
    const Cloud::Ptr cloud = cloud_of(depth, std::stof(argv[2]), std::stof(argv[3]), std::stof(argv[4]), std::stof(argv[5]));
    std::vector<float> floats;
    std::vector<int32_t> labels;
    Normals::Ptr found;
    if (task == "tiles") floats = tiles(cloud);
    else if (task == "segments") labels = segments(cloud);
    else found = normals(cloud, Estimation::AVERAGE_3D_GRADIENT, 7.f);
    const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
    if (found)
      for (const auto& one : *found) floats.insert(floats.end(), {one.normal_x, one.normal_y, one.normal_z});
    if (labels.empty()) write(path, floats);
    else write(path, labels);
    std::cout << seconds.count() << std::endl;
  }
}
