/* Tracks a spacecraft through PGM frames, half a second apart, within a deadline each; prints a line a frame.
 *
 *   track MODEL RUNTIME OPERATORS SECONDS STATE FRAME.pgm...
 *
 * OPERATORS and STATE may be "-"; a FRAME "-" never came. SECONDS 0 is no deadline.
 */
#include <ctype.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "ffpose_onboard.h"

static const char *named(const char *word) { return strcmp(word, "-") ? word : NULL; }

/* Reads a binary PGM of 8 bits without comments; pixels are NULL where there is none. */
static ffpose_image read_pgm(const char *path) {
  ffpose_image image = {.channels = 1};
  FILE *file = fopen(path, "rb");
  if (!file) return image;
  unsigned white = 0;
  if (fscanf(file, "P5 %u %u %u", &image.width, &image.height, &white) == 3 && white == 255 && isspace(fgetc(file))) {
    size_t size = (size_t)image.width * image.height;
    uint8_t *pixels = malloc(size);
    if (pixels && fread(pixels, 1, size, file) == size)
      image.pixels = pixels;
    else
      free(pixels);
  }
  fclose(file);
  return image;
}

int main(int count, char **words) {
  if (count < 7) {
    fprintf(stderr, "usage: track MODEL RUNTIME OPERATORS SECONDS STATE FRAME.pgm...\n");
    return 2;
  }
  ffpose_settings settings = {
      .model = words[1], .runtime = words[2], .operators = named(words[3]), .threads = 1};
  const char *state = named(words[5]);
  double deadline = atof(words[4]);
  ffpose *handle = NULL;
  if (ffpose_open(&settings, &handle) != FFPOSE_OK) {
    fprintf(stderr, "%s\n", ffpose_error());
    return 1;
  }
  for (int frame = 6; frame < count; frame++) {
    ffpose_image image = {0};
    int came = named(words[frame]) != NULL;
    if (came) image = read_pgm(words[frame]);
    ffpose_motion motion;
    int code = ffpose_track(handle, 0.5 * (frame - 5), came ? &image : NULL, deadline, &motion);
    free((void *)image.pixels);
    if (code == FFPOSE_OK || code == FFPOSE_LATE)
      printf("%d %d %d %.17g %.17g %.17g %.17g\n", code, motion.outcome, motion.has_track, motion.position_m[0],
             motion.position_m[1], motion.position_m[2], motion.covariance[0][0]);
    else
      printf("%d %s\n", code, ffpose_error());
  }
  int saved = !state || ffpose_save(handle, state) == FFPOSE_OK;
  if (!saved) fprintf(stderr, "%s\n", ffpose_error());
  ffpose_close(handle);
  return saved ? 0 : 1;
}
