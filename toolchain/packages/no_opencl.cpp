// What Debian's imgproc and dnn ask of OpenCV's core when it was built with OpenCL, in the words of one without: it is
// never at work, and no kernel runs.
#include <opencv2/core/ocl.hpp>

namespace cv::ocl {

bool isOpenCLActivated();
bool isOpenCLActivated() {
  return false;
}

bool Kernel::run_(int, std::size_t*, std::size_t*, bool, const Queue&) {
  return false;
}

namespace internal {

bool isPerformanceCheckBypassed();
bool isPerformanceCheckBypassed() {
  return false;
}

}  // namespace internal
}  // namespace cv::ocl
