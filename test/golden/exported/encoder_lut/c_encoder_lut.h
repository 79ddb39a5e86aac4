// a table that the firmware has measured itself: is replaced, and one that acted during the measurement is not in this one; measure with the firmware's own table switched off, and do not calibrate again
// zero_electric_angle (SimpleFOC): was found with the old table, and commutation needs the new one; align the motor again after the table was put in
// switch on: subtract the value, linear between two of them, from every reading
int16_t encoder_lut[36] = {
0, 0, 1, 2, 2, 2, 4, 6, 9, 12,
16, 19, 21, 22, 22, 21, 20, 18, 16, 15,
14, 12, 11, 10, 9, 8, 7, 7, 6, 6,
5, 3, 2, 1, 0, 0
};
