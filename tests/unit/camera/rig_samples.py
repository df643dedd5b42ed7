"""Made-up rigs with known numbers, and the same written down in every file format, by hand."""

import numpy as np

from machine.rotations import rotation_from_rotvec
from server.camera.rectification_rig import EyeCalibration, RigCalibration, checked_rig

SIZE_PX = (1280, 720)
TURN = np.array([-0.0009, 0.0062, 0.0008])  # RX, CV, RZ [rad]
PLACE_MM = np.array([119.978, 0.026, 0.0159])
LEFT = EyeCalibration(701.88, 701.7, 641.285, 344.1835, (-0.1753, 0.0283, 6.7e-05, -0.00015, 0.0))
RIGHT = EyeCalibration(700.965, 701.11, 633.515, 359.3135, (-0.1728, 0.0265, 0.00016, 1.0e-05, 0.0))


def brown_rig() -> RigCalibration:
    rig = RigCalibration(LEFT, RIGHT, rotation_from_rotvec(TURN), -1e-3 * PLACE_MM, *SIZE_PX)
    return checked_rig(rig, "sample")


def turned_rig() -> RigCalibration:
    """Badly aligned: degrees of pitch, yaw and roll, unequal lenses."""
    left = EyeCalibration(531.0, 529.0, 640.0, 350.0, (-0.17, 0.028, 6e-5, -1.5e-4, 1e-3))
    right = EyeCalibration(522.0, 524.0, 628.0, 371.0, (-0.15, 0.02, -2e-4, 3e-4, 0.0, 0.01, 0.002, 0.0))
    R = rotation_from_rotvec(np.array([0.02, -0.05, 0.03]))
    return checked_rig(RigCalibration(left, right, R, np.array([-0.1185, 0.004, -0.006]), *SIZE_PX), "sample")


def fisheye_rig() -> RigCalibration:
    left = EyeCalibration(410.0, 411.0, 635.0, 362.0, (-0.013, 0.002, -0.001, 0.0002), "fisheye")
    right = EyeCalibration(412.0, 410.0, 644.0, 355.0, (-0.012, 0.001, -0.0008, 0.0001), "fisheye")
    R = rotation_from_rotvec(np.array([0.01, 0.02, -0.008]))
    return checked_rig(RigCalibration(left, right, R, np.array([-0.11, 0.001, 0.002]), *SIZE_PX), "sample")


ZED = """[LEFT_CAM_2K]
fx=1403.76
fy=1403.4
cx=1109.57
cy=592.367
k1=-0.1753
k2=0.0283
p1=6.7e-05
p2=-0.00015
k3=0.0
[RIGHT_CAM_2K]
fx=1401.93
fy=1402.22
cx=1094.03
cy=622.627
k1=-0.1728
k2=0.0265
p1=0.00016
p2=1.0e-05
k3=0.0
[LEFT_CAM_HD]
fx=701.88
fy=701.7
cx=641.285
cy=344.1835
k1=-0.1753
k2=0.0283
p1=6.7e-05
p2=-0.00015
k3=0.0
[RIGHT_CAM_HD]
fx=700.965
fy=701.11
cx=633.515
cy=359.3135
k1=-0.1728
k2=0.0265
p1=0.00016
p2=1.0e-05
k3=0.0
[STEREO]
Baseline=119.978
TY=0.026
TZ=0.0159
CV_2K=0.0061
CV_HD=0.0062
RX_2K=-0.0009
RX_HD=-0.0009
RZ_2K=0.0008
RZ_HD=0.0008
[MISC]
Sensor_ID=0
"""

OPENCV = """%YAML:1.0
---
imageSize: [ 1280, 720 ]
K1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 701.88, 0., 641.285, 0., 701.7, 344.1835, 0., 0., 1. ]
D1: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -1.753e-01, 2.83e-02, 6.7e-05, -1.5e-04, 0. ]
K2: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 700.965, 0., 633.515, 0., 701.11, 359.3135, 0., 0., 1. ]
D2: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -1.728e-01, 2.65e-02, 1.6e-04, 1e-05, 0. ]
R: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ -9.0e-04, 6.2e-03, 8.0e-04 ]
T: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ -1.19978e+02, -2.6e-02, -1.59e-02 ]
"""

EUROC_LEFT = """# General sensor definitions.
sensor_type: camera
comment: VI-Sensor cam0 (MT9M034)
T_BS:
  cols: 4
  rows: 4
  data: [0.0, -1.0, 0.0, -0.02,
         1.0, 0.0, 0.0, -0.06,
         0.0, 0.0, 1.0, 0.01,
         0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.654, 457.296, 367.215, 248.375] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
"""
EUROC_RIGHT = EUROC_LEFT.replace("-0.02,", "-0.021,").replace("-0.06,", "0.05,").replace("458.654", "457.587")

ROS_LEFT = """image_width: 640
image_height: 480
camera_name: left
camera_matrix:
  rows: 3
  cols: 3
  data: [430.0, 0.0, 320.0, 0.0, 431.0, 240.0, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.35, 0.15, 5e-4, -2e-4, 0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [400, 0, 325, 0, 0, 400, 238, 0, 0, 0, 1, 0]
"""
ROS_RIGHT = ROS_LEFT.replace("325, 0, 0, 400", "325, -40, 0, 400").replace("430.0", "432.0")

KITTI = """P0: 7.070912e+02 0 6.018873e+02 0 0 7.070912e+02 1.831104e+02 0 0 0 1 0
P1: 7.070912e+02 0 6.018873e+02 -3.798145e+02 0 7.070912e+02 1.831104e+02 0 0 0 1 0
Tr: 1 0 0 0 0 1 0 0 0 0 1 0
"""

KALIBR = """cam0:
  camera_model: pinhole
  intrinsics: [410.0, 411.0, 635.0, 362.0]
  distortion_model: equidistant
  distortion_coeffs: [-0.013, 0.002, -0.001, 0.0002]
  resolution: [1280, 720]
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.11]
  - [0.0, 1.0, 0.0, 0.001]
  - [0.0, 0.0, 1.0, 0.002]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  intrinsics: [412.0, 410.0, 644.0, 355.0]
  distortion_model: equidistant
  distortion_coeffs: [-0.012, 0.001, -0.0008, 0.0001]
  resolution: [1280, 720]
"""
