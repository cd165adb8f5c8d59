/* Poses and tracks of a spacecraft for flight software: libffpose_onboard.
 *
 * Frames: the camera's (x right, y down, z forward; meters) and the object's; p_camera = R(q) p_object + t. Quaternions are
 * (w, x, y, z) of norm 1. A handle is used by one thread at a time: a call during another's, or of a handle that is closed, is
 * FFPOSE_FAILED; handles are independent, but the first one opened chooses ONNX Runtime's library for the process.
 *
 * Every function returns one of ffpose_code; ffpose_error() tells the thread's last error in a sentence, in which options of the
 * program (--camera, --operators, ...) stand for the fields of their names. Nothing is thrown.
 * Nothing is printed but where a panic was, on standard error. Nothing ends the process but a lack of memory or of stack, of which 256 KiB
 * are enough for the shipped networks, and pthread_cancel of a thread within a call. Paths are UTF-8.
 *
 * In a forked process a handle of the parent's goes on, on one thread, and ffpose_close does not give its memory back. That process has to
 * leave by _exit, as at exit ONNX Runtime waits for a thread of the parent's.
 */
#ifndef FFPOSE_ONBOARD_H
#define FFPOSE_ONBOARD_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef enum {
  FFPOSE_OK = 0,
  FFPOSE_LATE = 1,   /* the deadline passed: of a track the motion is there, coasted; of a pose nothing */
  FFPOSE_FAILED = 2, /* ffpose_error() says why; the track is as it was, and nothing was written to the caller's memory. Where an
                        image of a track is the reason, a call with a null image and the same time coasts over it */
  FFPOSE_NULL = 3,   /* a pointer that must not be null is, of an argument or in it: ffpose_error() names it; as FFPOSE_FAILED else */
  FFPOSE_PANIC = 4   /* a bug of the library; close the handle */
} ffpose_code;

typedef enum {
  FFPOSE_ACCEPTED = 0, /* the frame corrected the track */
  FFPOSE_SWITCHED = 1, /* another attitude leads from now on: the frame speaks for it, or none has for the one before (is_accepted) */
  FFPOSE_GATED = 2,    /* it is too far from what was expected; the track goes on without it */
  FFPOSE_COASTED = 3,  /* there was no frame, or not in time */
  FFPOSE_FLAGGED = 4,  /* it shows no spacecraft */
  FFPOSE_ACQUIRING = 5, /* there is no track yet */
  FFPOSE_LOST = 6      /* too long without a frame that could be believed, or too many views against it */
} ffpose_outcome;

typedef struct ffpose ffpose;

/* Paths; null where not needed. Zero everything first: a later version, for which programs are compiled anew, may add fields. */
typedef struct {
  const char *model;     /* X.onnx of `ffpose export`; X.track.onnx beside it is opened too, and must be there if X.onnx was
                            exported with --track */
  const char *runtime;   /* ONNX Runtime's library; null: ORT_DYLIB_PATH, else libonnxruntime.so */
  const char *operators; /* libffpose_ort.so, for models with filters */
  const char *camera;    /* JSON of the camera that takes the images, if another than the model's */
  const char *track;     /* JSON of a track's settings */
  const char *sha256;    /* that the model's file must have, 64 hexadecimal digits; it covers X.track.onnx, whose own X.onnx records */
  uint32_t threads;      /* that an image is computed with, up to 1,024; 0: ONNX Runtime's choice */
  uint32_t resize;       /* other than 0: images of any aspect ratio, as if the model's camera had taken them */
} ffpose_settings;

/* The caller's pixels, of which a copy is made: 8 bits a sample, rows from the top, one after the other in memory. */
typedef struct {
  const uint8_t *pixels;
  uint32_t width, height; /* up to 65,535 a side and 89,478,485 in all */
  uint32_t channels;      /* 1: gray, 3: red, green, blue */
  size_t stride;          /* bytes from row to row; 0: width times channels */
} ffpose_image;

typedef struct {
  double position_m[3];
  double orientation_wxyz[4];
  double position_covariance_m2[3][3];
  double rotation_covariance_rad2[3][3]; /* camera axes: R_true = exp([r]x) R; both covariances are NaN where the model has none */
  double degrees_of_freedom[2];          /* of the t distributions of position and rotation; infinite: Gaussian */
  double alternative_wxyz[4];            /* the second most likely orientation */
  double probabilities[2];               /* of the one and of the other */
  double in_view;
  int32_t is_flagged; /* 1: the image shows no spacecraft */
} ffpose_pose_result;

typedef struct {
  double time_s;
  int32_t outcome;   /* ffpose_outcome */
  int32_t has_track; /* 0: the numbers below are NaN */
  int32_t is_accepted; /* 1: the frame corrected the track; 0 of FFPOSE_SWITCHED: another leads, which the frame did not correct */
  double position_m[3];
  double orientation_wxyz[4];
  double velocity_m_s[3];           /* camera axes */
  double angular_velocity_deg_s[3]; /* object's axes; both relative to the camera, whose own turning but for `orbital_rate` is not told here: no gyro */
  /* of position (m), velocity (m/s), attitude (rad, object's axes: R_true = R exp([r]x)) and angular velocity (rad/s) */
  double covariance[12][12];
  double nis; /* squared Mahalanobis distance of the frame, six degrees of freedom; NaN without either */
} ffpose_motion;

/* Opens a model of an object's pose and an empty track; runs the model once, so that later runs allocate little. */
int32_t ffpose_open(const ffpose_settings *settings, ffpose **handle);

/* Poses one image within `seconds`: 0 or infinity for no limit, below 0 is late at once, before the image is looked at. Copying
 * the pixels, taking out a lens's distortion and resizing are each done whole; the network's run is ended between two nodes of its
 * graph, by a thread of ffpose_open's. For a caller of a real-time policy it takes a priority above the caller's: without the right to
 * it (Linux: CAP_SYS_NICE or RLIMIT_RTPRIO), on one processor, the run ends by itself, late. FFPOSE_OK means within the limit: an answer that comes after it is dropped, and the code is FFPOSE_LATE. */
int32_t ffpose_pose(ffpose *handle, const ffpose_image *image, double seconds, ffpose_pose_result *pose);

/* Moves the track on to `time_s`, later than before, by one look within `seconds` at where the object is expected. The whole frame is
 * searched, which takes about twice as long, without a track and where the last frame that was neither null nor late did not correct it:
 * give it that time, as with a limit too short for it every later frame is late too. A null image is a frame that never came.
 * Where no track leads, a time that is earlier by more than the setting `coasting` begins anew: of a finite one, a wrong time costs a
 * track no more than a gap; ffpose_reset does so at once. A model without uncertainty has poses alone: FFPOSE_FAILED. */
int32_t ffpose_track(ffpose *handle, double time_s, const ffpose_image *image, double seconds, ffpose_motion *motion);

/* Forgets the track and the times of its frames, as after ffpose_open: where a clock was set back, or the target is another one. */
int32_t ffpose_reset(ffpose *handle);

/* Writes the track to a file, by a new one that is renamed, one track to one file; and takes it up again, by the same model, camera (or resize) and
 * settings of the track: others' are refused. */
int32_t ffpose_save(const ffpose *handle, const char *path);
int32_t ffpose_restore(ffpose *handle, const char *path);

/* The thread's last error; valid until its next call. Empty in destructors of the thread that run after the library's own. */
const char *ffpose_error(void);

void ffpose_close(ffpose *handle); /* null is none, nor is one that is closed already */

#ifdef __cplusplus
}
#endif
#endif
