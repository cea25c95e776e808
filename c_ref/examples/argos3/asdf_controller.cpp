#include "asdf_controller.h"

#include "mcp_asdf_frame.h"

#include <cmath>

using namespace argos;

/* The t-table in vendor/mcp_asdf. Another one has another name, which `mcp-asdf firmware` prints. */
extern "C" {
extern const uint32_t mcp_asdf_t_table_omega05_q30[33];
}

namespace
{
/* A packet is the sender's id, which a range-and-bearing reading does not have, and the data of the frame
 * that the robot would send on a CAN bus. swarm.argos has its size as rab_data_size. */
const size_t FRAME_SIZE = 8;
const size_t PACKET_SIZE = 1 + FRAME_SIZE;
const mcp_asdf_frame_format_t ESTIMATE_FORMAT = MCP_ASDF_FORMAT_ESTIMATE;

/* The ground sensor that the paper's authors use, near the front right. */
const size_t GROUND_SENSOR = 3;

/* Return the number at the end of a robot's name, such as 7 of kiv7, modulo the firmware's 128 ids. Robots
 * of equal ids never take each other's estimates, and a robot that receives both in one tick takes one. */
uint8_t IdOfName(const std::string &name)
{
    const size_t digits = name.find_last_not_of("0123456789") + 1;
    if (digits == name.size()) {
        THROW_ARGOSEXCEPTION("robot \"" << name << "\" has no number at the end of its name; call it kiv0");
    }
    uint32_t id = 0;
    for (const char digit : name.substr(digits)) {
        id = (10U * id + static_cast<uint32_t>(digit - '0')) % (MCP_ASDF_MAX_ID + 1U);
    }
    return static_cast<uint8_t>(id);
}

/* Return the packet of an estimate. Throws CARGoSException for an estimate that no robot can have. */
CByteArray EncodePacket(const mcp_asdf_estimate_t &estimate)
{
    mcp_asdf_frame_t frame;
    const mcp_asdf_frame_status_t status = mcp_asdf_encode_estimate(&frame, &ESTIMATE_FORMAT, &estimate);
    if (status != MCP_ASDF_FRAME_OK) {
        THROW_ARGOSEXCEPTION("mcp_asdf_encode_estimate() returned " << status);
    }
    CByteArray packet(PACKET_SIZE);
    packet[0] = estimate.node;
    for (size_t index = 0; index < FRAME_SIZE; ++index) {
        packet[1 + index] = frame.data[index];
    }
    return packet;
}

/* Decode the estimate in a packet. Returns false if there is none. A robot that has not broadcast yet sends
 * zeros, which are no frame: its last byte cannot be 0. */
bool DecodePacket(mcp_asdf_estimate_t &estimate, const CByteArray &packet)
{
    if (packet.Size() != PACKET_SIZE || packet[0] > MCP_ASDF_NODE_MAX) {
        return false;
    }
    mcp_asdf_frame_t frame = {};
    frame.id = MCP_ASDF_FRAME_FILTER(ESTIMATE_FORMAT.subject) | packet[0];
    frame.length = FRAME_SIZE;
    for (size_t index = 0; index < FRAME_SIZE; ++index) {
        frame.data[index] = packet[1 + index];
    }
    return mcp_asdf_decode_estimate(&estimate, ESTIMATE_FORMAT.subject, &frame) == MCP_ASDF_FRAME_OK;
}

mcp_asdf_config_t ConfigOfFilter(const std::string &filter)
{
    if (filter == "off") {
        return MCP_ASDF_CONFIG_OFF;
    }
    if (filter == "asdf") {
        return MCP_ASDF_CONFIG_ASDF(mcp_asdf_t_table_omega05_q30);
    }
    if (filter == "robust") {
        return MCP_ASDF_CONFIG_ROBUST;
    }
    THROW_ARGOSEXCEPTION("filter is \"" << filter << "\"; it must be off, asdf or robust");
}

uint32_t FixedPointAccuracy(Real b_hat)
{
    const Real one = 4294967296.0; /* 2^32 */
    if (!(b_hat * one >= MCP_ASDF_B_HAT_MIN && b_hat * one <= MCP_ASDF_B_HAT_MAX)) {
        THROW_ARGOSEXCEPTION("b_hat is " << b_hat << "; it must be a probability, 0.000001 to 0.999999");
    }
    return static_cast<uint32_t>(std::lround(b_hat * one));
}
} // namespace

void AsdfController::Init(TConfigurationNode &parameters)
{
    wheels_ = GetActuator<CCI_DifferentialSteeringActuator>("differential_steering");
    transmitter_ = GetActuator<CCI_RangeAndBearingActuator>("range_and_bearing");
    receiver_ = GetSensor<CCI_RangeAndBearingSensor>("range_and_bearing");
    ground_sensor_ = GetSensor<CCI_KheperaIVGroundSensor>("kheperaiv_ground");
    proximity_sensor_ = GetSensor<CCI_KheperaIVProximitySensor>("kheperaiv_proximity");
    random_ = CRandom::CreateRNG("argos");
    try {
        ReadParameters(parameters);
        StartFirmware();
    } catch (CARGoSException &error) {
        THROW_ARGOSEXCEPTION_NESTED("cannot start the MCP-ASDF firmware of robot " << GetId(), error);
    }
}

void AsdfController::ReadParameters(TConfigurationNode &parameters)
{
    std::string filter;
    Real b_hat = 0.0;
    GetNodeAttribute(parameters, "filter", filter);
    GetNodeAttribute(parameters, "b_hat", b_hat);
    GetNodeAttribute(parameters, "sensor_accuracy", sensor_accuracy_);
    GetNodeAttributeOrDefault(parameters, "max_speed", max_speed_, max_speed_);
    GetNodeAttributeOrDefault(parameters, "log_folder", log_folder_, log_folder_);
    config_ = ConfigOfFilter(filter);
    GetNodeAttributeOrDefault(parameters, "filter_period", config_.filter_period, config_.filter_period);
    initial_b_hat_ = FixedPointAccuracy(b_hat);
    if (!(sensor_accuracy_ >= 0.0 && sensor_accuracy_ <= 1.0)) {
        THROW_ARGOSEXCEPTION("sensor_accuracy is " << sensor_accuracy_ << "; it must be 0 to 1");
    }
}

void AsdfController::StartFirmware()
{
    const mcp_asdf_status_t status = mcp_asdf_init(&firmware_, &config_, IdOfName(GetId()), initial_b_hat_);
    if (status == MCP_ASDF_ERR_CONFIG) {
        THROW_ARGOSEXCEPTION("filter_period is " << config_.filter_period << "; it must be 1 or more");
    }
    if (status != MCP_ASDF_OK) {
        THROW_ARGOSEXCEPTION("mcp_asdf_init() returned " << status << ", a mcp_asdf_status_t");
    }
    broadcast_count_ = 0;
    accepted_packets_ = 0;
    refused_packets_ = 0;
    motion_.Restart(max_speed_);
    log_.Start(log_folder_, GetId(), firmware_, config_);
}

void AsdfController::Reset() { StartFirmware(); }

void AsdfController::Destroy() { log_.Close(); }

void AsdfController::ControlStep()
{
    const WheelSpeeds speeds = motion_.ChooseSpeeds(proximity_sensor_->GetReadings());
    wheels_->SetLinearVelocity(speeds.left, speeds.right);

    Observe();
    /* What the neighbours receive in the next tick is the estimate with this tick's observation. */
    Broadcast();
    Receive();
    const mcp_asdf_status_t status = mcp_asdf_settle(&firmware_);
    log_.Settle(firmware_, status);
}

void AsdfController::Observe()
{
    /* The reading is 0 on black and 1 on white. ARGoS's sensor never errs, so errors are added here. */
    bool is_black = ground_sensor_->GetReadings()[GROUND_SENSOR].Value < 0.5;
    const bool is_correct = random_->Uniform(CRange<Real>(0.0, 1.0)) < sensor_accuracy_;
    if (!is_correct) {
        is_black = !is_black;
    }
    const mcp_asdf_observation_t colour = is_black ? MCP_ASDF_BLACK : MCP_ASDF_WHITE;
    mcp_asdf_observe(&firmware_, colour);
    log_.Observe(colour);
}

void AsdfController::Broadcast()
{
    const mcp_asdf_estimate_t estimate = {mcp_asdf_id(&firmware_), broadcast_count_,
                                          mcp_asdf_x_hat(&firmware_), mcp_asdf_alpha(&firmware_)};
    ++broadcast_count_;
    transmitter_->SetData(EncodePacket(estimate));
}

void AsdfController::Receive()
{
    for (const auto &reading : receiver_->GetReadings()) {
        if (ReceivePacket(reading.Data)) {
            ++accepted_packets_;
        } else {
            ++refused_packets_;
        }
    }
}

/* Give the estimate in a packet to the firmware, and log it. Returns false if there is none, or if the
 * firmware refuses it. */
bool AsdfController::ReceivePacket(const CByteArray &packet)
{
    mcp_asdf_estimate_t estimate;
    if (!DecodePacket(estimate, packet)) {
        return false;
    }
    const mcp_asdf_status_t status =
        mcp_asdf_receive(&firmware_, estimate.node, estimate.x_hat, estimate.alpha);
    log_.Receive(estimate, status);
    return status == MCP_ASDF_OK;
}

REGISTER_CONTROLLER(AsdfController, "asdf_controller")
