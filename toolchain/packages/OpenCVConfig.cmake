# OpenCV 4.6.0 as Debian 12 has it, linked statically: imgproc, dnn, and aruco with calib3d are Debian's own archives, the code
# that the build for this machine runs; core and imgcodecs are built from the same sources without what Ubuntu calls otherwise
# (toolchain/opencv).
if(NOT TARGET opencv_core)
  add_library(opencv_core STATIC IMPORTED GLOBAL)
  set_target_properties(opencv_core PROPERTIES IMPORTED_LOCATION ${GODWIT_OPENCV_BUILT}/libopencv_core.a
                        INTERFACE_INCLUDE_DIRECTORIES ${GODWIT_OPENCV_DEBIAN}/usr/include/opencv4
                        INTERFACE_LINK_LIBRARIES "godwit_no_opencl;${ZLIB_LIBRARY};pthread;dl;m")
  set(debian ${GODWIT_OPENCV_DEBIAN}/usr/lib/${CMAKE_LIBRARY_ARCHITECTURE})
  add_library(opencv_imgproc STATIC IMPORTED GLOBAL)
  set_target_properties(opencv_imgproc PROPERTIES IMPORTED_LOCATION ${debian}/libopencv_imgproc.a
                        INTERFACE_LINK_LIBRARIES opencv_core)
  add_library(opencv_dnn STATIC IMPORTED GLOBAL)
  set_target_properties(opencv_dnn PROPERTIES IMPORTED_LOCATION ${debian}/libopencv_dnn.a
                        INTERFACE_LINK_LIBRARIES "opencv_imgproc;opencv_core;${debian}/libprotobuf.a")
  add_library(opencv_imgcodecs STATIC IMPORTED GLOBAL)
  set_target_properties(opencv_imgcodecs PROPERTIES IMPORTED_LOCATION ${GODWIT_OPENCV_BUILT}/libopencv_imgcodecs.a
                        INTERFACE_LINK_LIBRARIES "opencv_imgproc;opencv_core;${PNG_LIBRARY};${JPEG_LIBRARY};${ZLIB_LIBRARY}")
  # Boards and calibration by them.
  foreach(library flann features2d calib3d aruco)
    add_library(opencv_${library} STATIC IMPORTED GLOBAL)
    set_target_properties(opencv_${library} PROPERTIES IMPORTED_LOCATION ${debian}/libopencv_${library}.a)
  endforeach()
  set_target_properties(opencv_flann PROPERTIES INTERFACE_LINK_LIBRARIES opencv_core)
  set_target_properties(opencv_features2d PROPERTIES INTERFACE_LINK_LIBRARIES "opencv_flann;opencv_imgproc;opencv_core")
  set_target_properties(opencv_calib3d PROPERTIES INTERFACE_LINK_LIBRARIES "opencv_features2d;opencv_imgproc;opencv_core")
  set_target_properties(opencv_aruco PROPERTIES INTERFACE_LINK_LIBRARIES "opencv_calib3d;opencv_imgproc;opencv_core")
  # Debian's archives ask whether OpenCL is at work, in a core that has none.
  add_library(godwit_no_opencl STATIC ${CMAKE_CURRENT_LIST_DIR}/no_opencl.cpp)
  target_include_directories(godwit_no_opencl SYSTEM PRIVATE ${GODWIT_OPENCV_DEBIAN}/usr/include/opencv4)
endif()
set(OpenCV_VERSION 4.6.0)
set(OpenCV_INCLUDE_DIRS ${GODWIT_OPENCV_DEBIAN}/usr/include/opencv4)
set(OpenCV_LIBS ${OpenCV_FIND_COMPONENTS})
foreach(component ${OpenCV_FIND_COMPONENTS})
  if(NOT TARGET opencv_${component})
    set(OpenCV_FOUND FALSE)
    set(OpenCV_NOT_FOUND_MESSAGE "the packages' OpenCV has no ${component}")
  endif()
endforeach()
list(TRANSFORM OpenCV_LIBS PREPEND opencv_)
