import com.fasterxml.jackson.databind.JsonNode;
import com.fasterxml.jackson.databind.ObjectMapper;
import java.io.File;
import java.time.Duration;
import java.time.Instant;
import java.util.List;
import org.gridpose.ApiClient;
import org.gridpose.api.AnalysesApi;
import org.gridpose.api.MeasurementsApi;
import org.gridpose.api.SessionsApi;
import org.gridpose.api.TargetsApi;
import org.gridpose.model.Counts;
import org.gridpose.model.PoseRepeatability;
import org.gridpose.model.SessionCreate;
import org.gridpose.model.SessionRead;
import org.gridpose.model.TargetCreate;
import org.gridpose.model.TargetRead;

/** Measures a session with the generated Java client: {@code Measure URL KEY MANIFEST}. */
public final class Measure {
    public static void main(String[] arguments) throws Exception {
        JsonNode manifest = new ObjectMapper().readTree(new File(arguments[2]));
        ApiClient client = new ApiClient();
        client.updateBaseUri(arguments[0]);
        client.setRequestInterceptor(request -> request.header("Authorization", "Bearer " + arguments[1]));

        TargetCreate described = client.getObjectMapper().treeToValue(manifest.get("target"), TargetCreate.class);
        TargetRead target = new TargetsApi(client).createTarget(described, null);
        SessionsApi sessions = new SessionsApi(client);
        SessionRead session =
            sessions.createSession(new SessionCreate().name("Java").targetIds(List.of(target.getId())), null);
        MeasurementsApi measurements = new MeasurementsApi(client);
        for (JsonNode image : manifest.get("images")) {
            // As a form: the generator's native library would send the file of putImage as JSON.
            measurements.createImage(
                session.getId(),
                new File(image.get("path").asText()),
                image.get("pose_id").asText(),
                image.get("cycle").asInt(),
                null, null, null, null, null, null);
        }
        Instant deadline = Instant.now().plus(Duration.ofMinutes(1));
        while (true) {
            Counts counts = sessions.getSession(session.getId()).getCounts();
            if (counts.getQueued() + counts.getRunning() == 0) {
                break;
            }
            if (Instant.now().isAfter(deadline)) {
                throw new IllegalStateException(counts.toString());
            }
            Thread.sleep(100);
        }
        PoseRepeatability row = new AnalysesApi(client)
            .getRepeatability(session.getId(), null, null, null, null, null, null, null, null, null)
            .getPoses().stream().filter(each -> each.getPoseId().equals("P1")).findFirst().orElseThrow();
        double measured = row.getRepeatability().getRpLMm().doubleValue();
        double expected = manifest.get("rp_l_mm").asDouble();
        if (row.getCycles() != manifest.get("cycles").asInt()
            || Math.abs(measured - expected) > manifest.get("tolerance").asDouble() * expected) {
            throw new IllegalStateException(row.getCycles() + " cycles, RP_l " + measured + " mm, truly " + expected);
        }
        System.out.printf(
            "          P1: RP_l %.3f mm, truly %.3f mm, verdict %s%n", measured, expected, row.getVerdict());
    }
}
